"""The posterior distribution of a log's unknowns, from the likelihood of `shooting`."""

import numpy as np

from capsule_gym.identification.shooting import ShootingProblem

try:
    from scipy.interpolate import Akima1DInterpolator
except ImportError as error:
    raise ImportError('identify needs scipy: pip install "capsule-gym[identify]"') from error

# The reduction of the sum of squares that ends the last fits.
FINEST = 0.03
# The number of samples of a posterior, and of the draws from which they are chosen.
SAMPLES = 5000
PROPOSALS = 200_000
# The number of static ratios, and of lags, at which the others are fitted.
NODES = 7
# The standard deviation of the lag's share below which the likelihood is normal in it, too.
NARROW = 0.08
# How many times larger the sums of squares at all but the best two nodes are where the log has no
# noise; the width of the shares at which the search between them ends.
DECISIVE = 2.0
NARROWEST = 1e-6


def sample_posterior(
    problem: ShootingProblem, unknowns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples the posterior distribution of the shares, from unknowns near its largest density.

    The likelihood is approximated as normal in the ranges, but for two quantities, over which the
    others are fitted. With the static ratio it jumps; the others are those of its best value. Lag
    and latency act alike along a curve; the others are interpolated between several lags. A log
    without noise determines both, and the approximation is that of all quantities.

    Returns:
        Samples, shape (samples, shares), and the unknowns of the largest likelihood.
    """
    if "static_ratio" not in problem.names:
        return sample_smooth(problem, unknowns)
    place = problem.names.index("static_ratio")
    low = 0.0
    high = 1.0
    while True:
        nodes = np.linspace(low, high, NODES)
        problems, found, costs = fit_nodes(problem, "static_ratio", nodes, unknowns)
        best = int(costs.argmin())
        unknowns = np.insert(found[best], place, nodes[best])
        _, _, third, *_ = np.sort(costs)
        if third < DECISIVE * costs[best] or high - low < NARROWEST:
            break
        problem.estimate_noise(unknowns)
        low, high = nodes[[max(best - 1, 0), min(best + 1, NODES - 1)]]
    generator = np.random.default_rng(0)
    drawn = draw_profiled(problem, place, nodes, costs, generator)
    samples, end = sample_smooth(problems[best], found[best])
    # The other draws have the same seed: in their order all would rise with the static ratio.
    samples = generator.permutation(samples)
    return np.insert(samples, place, drawn, axis=1), np.insert(end, place, nodes[best])


def sample_smooth(problem: ShootingProblem, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`sample_posterior` where the likelihood does not jump."""
    unknowns, _ = problem.fit(unknowns, FINEST)
    samples = laplace(problem, unknowns)
    if "lag" not in problem.names:
        return samples, unknowns
    place = problem.names.index("lag")
    if samples[:, place].std() < NARROW:
        return samples, unknowns
    nodes = np.linspace(0.0, 1.0, NODES)
    problems, found, costs = fit_nodes(problem, "lag", nodes, unknowns)
    drawn = draw_profiled(problem, place, nodes, costs, np.random.default_rng(0))
    samples = np.clip(sample_between(problems, nodes, found, drawn), 0.0, 1.0)
    best = np.argmin(costs)
    unknowns, _ = problem.fit(np.insert(found[best], place, nodes[best]), FINEST)
    return np.insert(samples, place, drawn, axis=1), unknowns


def draw_profiled(
    problem: ShootingProblem,
    place: int,
    nodes: np.ndarray,
    costs: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Samples of the share of a profiled quantity, from the sums of squares at the nodes."""
    places = (np.arange(1000) + 0.5) / 1000.0
    shares = nodes[0] + places * (nodes[-1] - nodes[0])
    if problem.names[place] == "lag":
        cost = Akima1DInterpolator(nodes, costs)(shares)
    else:
        # Where the likelihood jumps, it may be as large in between as at the better end.
        intervals = (places * (NODES - 1)).astype(int)
        better = np.minimum(costs[:-1], costs[1:])
        cost = better[intervals]
    log_likelihood = -0.5 * (cost - cost.min())
    density = np.exp(log_likelihood + shares * problem.densities[place])
    return generator.choice(shares, SAMPLES, p=density / density.sum())


def laplace(problem: ShootingProblem, unknowns: np.ndarray) -> np.ndarray:
    """Samples the normal approximation of the likelihood in the ranges.

    Returns:
        Shares, shape (samples, shares).
    """
    r, jacobian = problem.residuals(unknowns)
    count = len(problem.names)
    # Drawn with a normal prior as wide as the ranges, which the weights take back; the inverse of
    # its deviation.
    prior = np.where(np.arange(len(unknowns)) < count, 1.0, 1e-3)
    matrix = np.vstack([jacobian, np.diag(prior)])
    right_side = np.append(-r, prior * (0.5 - unknowns))
    # With the states first, the last rows of R are those of the shares alone. Normal equations
    # would square the condition number, which is large where no reading determines a state.
    columns = np.column_stack([matrix[:, count:], matrix[:, :count], right_side])
    _, R = np.linalg.qr(columns)
    of_shares = R[-count - 1 : -1, -count - 1 :]
    factor = np.linalg.inv(of_shares[:, :-1])
    middle = unknowns[:count] + factor @ of_shares[:, -1]
    generator = np.random.default_rng(0)
    normal = generator.standard_normal((PROPOSALS, count))
    drawn = middle + normal @ factor.T
    inside = ((drawn >= 0.0) & (drawn <= 1.0)).all(axis=1)
    # A likelihood far outside of the ranges, which hardly any sample meets.
    drawn = drawn[inside] if inside.sum() > 500 else np.clip(drawn, 0.0, 1.0)
    without_prior = 0.5 * np.sum((drawn - 0.5) ** 2, axis=1)
    weights = np.exp(without_prior + (drawn - 1.0) @ problem.densities)
    chosen = generator.choice(len(drawn), SAMPLES, p=weights / weights.sum())
    return drawn[chosen]


def fit_nodes(
    problem: ShootingProblem, name: str, nodes: np.ndarray, unknowns: np.ndarray
) -> tuple[list[ShootingProblem], np.ndarray, np.ndarray]:
    """The problem with a quantity at each node of its share, fitted from the nearest end.

    Returns:
        The problems, their unknowns, and their sums of squares.
    """
    place = problem.names.index(name)
    problems = [problem.at(name, node) for node in nodes]
    ends = [(unknowns[place], np.delete(unknowns, place))]
    found = np.empty((NODES, len(unknowns) - 1))
    costs = np.empty(NODES)
    for n in np.argsort(np.abs(nodes - unknowns[place])):
        node = nodes[n]
        # The last of equally near ones: a fit at this very place.
        _, start = min(reversed(ends), key=lambda end: abs(end[0] - node))
        found[n], costs[n] = problems[n].fit(start, FINEST)
        ends.append((node, found[n]))
    return problems, found, costs


def sample_between(
    problems: list[ShootingProblem], nodes: np.ndarray, found: np.ndarray, drawn: np.ndarray
) -> np.ndarray:
    """Samples of the other shares at drawn shares of the lag, from the fits at the nodes.

    Their mean is interpolated; their deviations from it are those at the nearest node.
    """
    parts = np.array([laplace(problem, end) for problem, end in zip(problems, found, strict=True)])
    middles = parts.mean(axis=1)
    deviations = parts - middles[:, None]
    nearest = np.abs(np.subtract.outer(drawn, nodes)).argmin(axis=1)
    mean = Akima1DInterpolator(nodes, middles)
    return mean(drawn) + deviations[nearest, range(SAMPLES)]
