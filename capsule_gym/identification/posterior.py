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
# The quantities over which the others are fitted, and the shares of their ranges at which they are.
PROFILED = ("static_ratio", "lag")
NODES = np.linspace(0.0, 1.0, 7)


def sample_posterior(
    problem: ShootingProblem, unknowns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples the posterior distribution of the shares, from unknowns near its largest density.

    The likelihood is approximated as normal in the ranges, but for two quantities, over which the
    others are fitted. With the static ratio it jumps; the others are those of its best value. Lag
    and latency act alike along a curve; the others are interpolated between several lags.

    Returns:
        Samples, shape (samples, shares), and the unknowns of the largest likelihood.
    """
    name = next((each for each in PROFILED if each in problem.names), None)
    if name is None:
        unknowns, _ = problem.fit(unknowns, FINEST)
        return laplace(problem, unknowns), unknowns
    place = problem.names.index(name)
    problems = [problem.at(name, node) for node in NODES]
    found, costs = fit_nodes(problems, unknowns, place)
    best = np.argmin(costs)
    generator = np.random.default_rng(0)
    drawn = draw_profiled(problem, place, costs, generator)
    if name == "lag":
        samples = sample_between(problems, found, drawn)
        unknowns = np.insert(found[best], place, NODES[best])
        unknowns, _ = problem.fit(unknowns, FINEST)
    else:
        samples, end = sample_posterior(problems[best], found[best])
        # The other draws have the same seed: in their order all would rise with the static ratio.
        samples = generator.permutation(samples)
        unknowns = np.insert(end, place, NODES[best])
    samples = np.clip(samples, 0.0, 1.0)
    return np.insert(samples, place, drawn, axis=1), unknowns


def draw_profiled(
    problem: ShootingProblem, place: int, costs: np.ndarray, generator: np.random.Generator
) -> np.ndarray:
    """Samples of the share of a profiled quantity, from the sums of squares at the nodes."""
    shares = (np.arange(1000) + 0.5) / 1000.0
    if problem.names[place] == "lag":
        cost = Akima1DInterpolator(NODES, costs)(shares)
    else:
        # Where the likelihood jumps, it may be as large in between as at the better end.
        intervals = (shares * (len(NODES) - 1)).astype(int)
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
    # Drawn with a normal prior as wide as the ranges, which the weights take back.
    prior = np.where(np.arange(len(unknowns)) < count, 1.0, 1e-6)
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior))
    gradient = prior * (0.5 - unknowns) - jacobian.T @ r
    middle = unknowns + covariance @ gradient
    factor = np.linalg.cholesky(covariance[:count, :count])
    generator = np.random.default_rng(0)
    normal = generator.standard_normal((PROPOSALS, count))
    drawn = middle[:count] + normal @ factor.T
    inside = ((drawn >= 0.0) & (drawn <= 1.0)).all(axis=1)
    # A likelihood far outside of the ranges, which hardly any sample meets.
    drawn = drawn[inside] if inside.sum() > 500 else np.clip(drawn, 0.0, 1.0)
    without_prior = 0.5 * np.sum((drawn - 0.5) ** 2, axis=1)
    weights = np.exp(without_prior + (drawn - 1.0) @ problem.densities)
    chosen = generator.choice(len(drawn), SAMPLES, p=weights / weights.sum())
    return drawn[chosen]


def fit_nodes(
    problems: list[ShootingProblem], unknowns: np.ndarray, place: int
) -> tuple[np.ndarray, np.ndarray]:
    """The unknowns and the sum of squares at each node, each fit from the nearest end."""
    ends = [(unknowns[place], np.delete(unknowns, place))]
    found = np.empty((len(NODES), len(unknowns) - 1))
    costs = np.empty(len(NODES))
    for n in np.argsort(np.abs(NODES - unknowns[place])):
        node = NODES[n]
        # The last of equally near ones: a fit at this very place.
        _, start = min(reversed(ends), key=lambda end: abs(end[0] - node))
        found[n], costs[n] = problems[n].fit(start, FINEST)
        ends.append((node, found[n]))
    return found, costs


def sample_between(
    problems: list[ShootingProblem], found: np.ndarray, drawn: np.ndarray
) -> np.ndarray:
    """Samples of the other shares at drawn shares of the lag, from the fits at the nodes.

    Their mean is interpolated; their deviations from it are those at the nearest node.
    """
    parts = np.array([laplace(problem, end) for problem, end in zip(problems, found, strict=True)])
    middles = parts.mean(axis=1)
    deviations = parts - middles[:, None]
    nearest = np.abs(np.subtract.outer(drawn, NODES)).argmin(axis=1)
    mean = Akima1DInterpolator(NODES, middles)
    return mean(drawn) + deviations[nearest, range(SAMPLES)]
