// Environments with options, plants and states that Python accepts: their episodes stay finite,
// torques and observations stay within their limits, and a batch gives the bits of its environments
// alone.
#include <cstring>
#include <memory>
#include <vector>

#include "../../capsule_gym/core/bindings/description.hpp"
#include "../../capsule_gym/core/step/resets.hpp"
#include "../../capsule_gym/core/step/step.hpp"
#include "input.hpp"

using namespace fuzz;

namespace {
#define CHECK(condition) \
  if (!(condition)) __builtin_trap()

// The limits of capsule_gym/parameters/limits.py.
constexpr double SMALLEST = 1e-12, LARGEST = 1e12;
constexpr double SHORTEST_STEP = 1e-9, LONGEST_STEP = 1e6;
constexpr Constants<double> USUAL = {0.138, 0.3, 9.81, 0.36, 0.0923, 1.3, 1.0, 0.1, 0.1, 0.1, 0.1};
constexpr Constants<double> LOWEST = {SMALLEST, SMALLEST, SMALLEST, 0.0,  0.0, 1.0,
                                      SMALLEST, 0.0,      0.0,      -1.5, 0.0};
constexpr Constants<double> HIGHEST = {LARGEST, LARGEST, LARGEST, LARGEST, LARGEST, LARGEST,
                                       LARGEST, LARGEST, LARGEST, 1.5,     LARGEST};
constexpr int STRIBECK_SPEED = 8;
constexpr double LARGEST_DISTURBANCE = 1e3;
constexpr double LONGEST_LATENCY = 0.5;
constexpr Range ABSENT = {__builtin_nan(""), __builtin_nan("")};
// A longer history takes too much of the fuzzer's memory and time.
constexpr long long MOST_ROWS = 4000;
constexpr int MOST_STEPS = 12;
constexpr int USER_LAW = 9;
// Of capsule_gym/envs/contract.py.
constexpr double STABLE = 2.6;

// 0 or at least SMALLEST.
double divisor(double number) { return number < SMALLEST ? 0.0 : number; }

Range range(Input& in, double usual, double low, double high) {
  double one = in.number(usual, low, high);
  double other = in.flag() ? one : in.number(usual, low, high);
  return {std::fmin(one, other), std::fmax(one, other)};
}

void choose_plant(Input& in, Options& o) {
  bool varies = in.flag();
  o.M = in.number(0.5, SMALLEST, LARGEST);
  o.mu = in.number(0.3, 0.0, LARGEST);
  o.M_range = in.flag() ? range(in, 0.5, SMALLEST, LARGEST) : ABSENT;
  o.mu_range = in.flag() ? range(in, 0.3, 0.0, LARGEST) : ABSENT;
  o.log_mu = in.flag() && o.mu_range.low > 0.0 && o.mu_range.high / o.mu_range.low <= 1e300;
  o.paper_normal_force = in.flag();
  for (int n = 0; n < NUM_CONSTANTS; n++) {
    double low = (&LOWEST.m)[n], high = (&HIGHEST.m)[n], usual = (&USUAL.m)[n];
    bool plain = n >= 5 && in.flag();
    double value = plain ? low == -1.5 ? 0.0 : std::fmin(std::fmax(low, 0.0), 1.0)
                         : in.number(usual, low, high);
    (&o.m)[n] = n == STRIBECK_SPEED ? divisor(value) : value;
    bool drawn = varies && in.whole(0, 3) == 0;
    if (n == STRIBECK_SPEED) low = SMALLEST;
    (&o.m_range)[n] = drawn ? range(in, usual, low, high) : ABSENT;
  }
}

// Whether no plant admits Painleve's paradox, as `Capsule.check_plant`.
bool solvable(const Options& o, double M, double mu) {
  double m = range_of(o.m_range, o.m).high;
  double backward = range_of(o.backward_ratio_range, o.backward_ratio).high;
  double most = mu * std::fmax(1.0, backward) * range_of(o.static_ratio_range, o.static_ratio).high;
  return (M + m) / m > (1.0 + std::sqrt(1.0 + most * most)) / 2.0;
}

// `Capsule.fastest_rate`.
double fastest_root(double damping, double stiffness) {
  double square = damping * damping / 4.0 - stiffness;
  return square >= 0.0 ? damping / 2.0 + std::sqrt(square) : std::sqrt(stiffness);
}
double fastest_rate(const Constants<double>& p, double M, double mu, bool paper) {
  mu *= std::fmax(1.0, p.backward_ratio);
  double share = p.m / (M + p.m);
  double secant = std::sqrt(1.0 + mu * mu);
  double remains = 1.0 - share * (1.0 + secant) / 2.0;
  if (!(remains > 0.0)) return INFINITY;
  double inertia = p.m * p.l * p.l * remains;
  double pivot = paper ? 0.5 * mu * share * p.l : 0.0;
  double motor = MOTOR_SLOPE * p.motor_friction / MOTOR_WIDTH;
  double damping = (1.0 + pivot) * (p.c + motor) / inertia;
  double weight = p.m * p.g * p.l;
  double spring = (1.0 + M_PI) * pivot;
  double lowest = (1.0 - spring) * p.k - weight * secant;
  double highest = (1.0 + spring) * p.k + weight * mu;
  double root =
      std::fmax(fastest_root(damping, lowest / inertia), fastest_root(damping, highest / inertia));
  double viscous = p.viscous / ((M + p.m) * remains);
  double falling =
      p.stribeck_speed > 0.0 ? 0.65 * mu * (p.static_ratio - 1.0) * p.g / p.stribeck_speed : 0.0;
  return root + (viscous + falling * (M + p.m) / M);
}

void choose_disturbances(Input& in, Options& o) {
  o.disturbed = in.flag();
  o.law_observes = in.flag();
  o.agent_observes = !o.law_observes || in.flag();
  o.with_theta = in.flag();
  o.with_theta_dot = in.flag();
  o.with_x_dot = in.flag();
  o.stick_threshold = in.number(0.01, 0.0, LARGEST_DISTURBANCE);
  o.x_noise = in.flag() ? in.number(0.01, 0.0, LARGEST_DISTURBANCE) : __builtin_nan("");
  Range* next = &o.disturbances_theta_noise;
#define FIELD(name)                                                                        \
  {                                                                                        \
    const char* text = #name;                                                              \
    auto has = [=](const char* part) { return std::strstr(text, part) != nullptr; };       \
    bool delays = has("latency") || has("jitter");                                         \
    bool divides = has("resolution") || has("lag");                                        \
    bool decays = has("drift_time");                                                       \
    double low = decays ? SHORTEST_STEP : has("bias") ? -LARGEST_DISTURBANCE : 0.0;        \
    double high = delays ? LONGEST_LATENCY : has("lost") ? 1.0 : LARGEST_DISTURBANCE;      \
    double absent = decays ? 0.05 : 0.0;                                                   \
    bool acts = o.disturbed != 0.0 && in.whole(0, 2) == 0;                                 \
    *next = acts ? range(in, has("hold") ? 3.0 : 0.01, low, high) : Range{absent, absent}; \
    if (divides) *next = {divisor(next->low), divisor(next->high)};                        \
    next++;                                                                                \
  }
  CAPSULE_DISTURBANCES(FIELD)
#undef FIELD
}

// The law of an environment, its constants, memory and reference.
struct Choice {
  int law = 0;
  std::vector<double> constants, memory, reference;
  long long reference_rows = 1;
  double gain = 0.0;  // of the user's law
};

void fill(Input& in, std::vector<double>& numbers, size_t count) {
  bool any = in.flag();
  for (size_t n = 0; n < count; n++)
    numbers.push_back(any ? std::fmin(std::fmax(in.any(), -1e300), 1e300)
                          : in.number(1.0, -20.0, 20.0));
}

void choose_law(Input& in, Options& o, Choice& c) {
  c.law = in.flag() ? in.whole(0, USER_LAW) : 0;
  o.controller = c.law > 0;
  o.memory_size = 1;
  o.reference_size = 2;
  size_t constants = 1;
  auto take = [&]<class Law>() {
    size_t task_rows = 0;
    if constexpr (__is_same(Law, GoalPulses)) o.task = 1, task_rows = WIDTH<Goal::Memory<double>>;
    if constexpr (__is_same(Law, VelocityPulses))
      o.task = 2, task_rows = WIDTH<Velocity::Memory<double>>;
    o.memory_size = Law::MEMORY;
    o.reference_size = Law::COLUMNS - task_rows;
    constants = sizeof(Law) / sizeof(double) + 1;
  };
  if (!with_type(Laws(), c.law, take)) {
    o.memory_size = in.whole(1, 3);
    o.reference_size = in.whole(2, 4);
  }
  fill(in, c.constants, constants);
  fill(in, c.memory, o.memory_size);
  c.reference_rows = o.controller ? in.whole(1, 3) : 1;
  if (o.controller) fill(in, c.reference, c.reference_rows * o.reference_size);
  else c.reference.assign(2, 0.0), c.memory.assign(1, 0.0);
  c.gain = in.any();
}

void choose_times(Input& in, Options& o) {
  double substep = in.flag() ? 1e-3 : in.number(1e-3, SHORTEST_STEP, 1e3);
  int physics_steps = in.whole(1, 4);
  int law_steps = in.whole(1, 3);
  o.law_dt = physics_steps * substep;
  o.control_dt = o.controller != 0.0 ? law_steps * o.law_dt : o.law_dt;
  o.physics_dt = in.flag() ? substep : __builtin_nan("");
}

void choose_options(Input& in, Options& o, Choice& c) {
  constexpr double NONE = __builtin_nan("");
  o.task = in.whole(0, 2);
  choose_law(in, o, c);
  choose_times(in, o);
  o.task_range =
      o.task == 2 && in.flag() ? range(in, 0.1, -LARGEST_COMMAND, LARGEST_COMMAND) : ABSENT;
  o.torque_limit = in.number(1.5, 5e-324, 1e6);
  o.residual_limit = in.flag() ? in.number(0.5, 0.0, 1e6) : NONE;
  o.total_torque = in.flag();
  o.energy_weight = in.number(0.1, 0.0, 1e12);
  o.termination_penalty = in.number(10.0, 0.0, 1e12);
  o.observe_parameters = in.flag();
  o.observe_estimates = in.flag();
  o.stack_size = in.flag() ? in.whole(1, 100) : 1;
  o.goal_env = o.task == 1 && in.flag();
  bool wide = in.flag();
  o.initial_noise = wide ? 0.0 : in.number(0.1, 0.0, 0.5);
  o.initial_theta = wide ? in.number(0.5, 0.0, std::nextafter(THETA_LIMIT, 0.0)) : NONE;
  o.initial_theta_dot = wide ? in.number(5.0, 0.0, 1e3) : NONE;
  choose_plant(in, o);
  choose_disturbances(in, o);
}

// Whether the periods divide each other, as `check_periods` of capsule_gym/envs/contract.py.
bool divides(const Options& o, const Settings& s) {
  auto fits = [](double whole, double part, double count) {
    return count >= 1.0 && count <= 64.0 && std::fabs(count * part - whole) <= 1e-9 * whole;
  };
  return o.control_dt >= SHORTEST_STEP && o.control_dt <= LONGEST_STEP &&
         fits(s.law_dt, s.physics_dt, s.physics_steps) && fits(o.control_dt, s.law_dt, s.law_steps);
}

struct User {
  double gain;
  long long lanes;
};
void user_law(void* data, double* block, double* torques, long long n) {
  auto [gain, lanes] = *(const User*)data;
  for (long long j = 0; j < n; j++) {
    torques[j] = gain * block[j];
    block[NUM_ROWS * lanes + j] += 1.0;
  }
}

// What every environment of a case shares.
struct Setup {
  Options options;
  Choice choice;
  Description description;
  std::vector<Word> keys;
  std::vector<Change> changes;
  std::vector<double> state;
};

// Some of its environments, from `first` on.
struct Simulation {
  const Setup& setup;
  long long first, count, lanes;
  std::vector<double> world, drawn;
  std::vector<float> observations;
  std::vector<long long> episodes, rows;
  std::vector<Change> changes;
  User user;
  Batch batch = {};

  Simulation(const Setup& setup, long long first, long long count, long long lanes)
      : setup(setup), first(first), count(count), lanes(lanes) {
    const Layout& layout = setup.description.layout;
    world.resize(layout.rows * lanes);
    drawn.resize(layout.draws * count);
    observations.resize(layout.entries * count);
    episodes.resize(count);
    for (long long i = 0; i < count; i++) rows.push_back(i);
    for (Change change : setup.changes) {
      change.environment -= first;
      if (change.environment >= 0 && change.environment < count) changes.push_back(change);
    }
    user = {setup.choice.gain, lanes};
    batch.world = world.data();
    batch.num_envs = count;
    batch.lanes = lanes;
    batch.observations = observations.data();
    batch.settings = &setup.description.settings;
    batch.layout = &layout;
    batch.task = setup.options.task;
    batch.law = setup.choice.law;
    batch.law_constants = setup.choice.constants.data();
    batch.user_law = user_law;
    batch.user_data = &user;
    batch.memory = setup.choice.memory.data();
    batch.reference = setup.choice.reference.data();
    batch.reference_rows = setup.choice.reference_rows;
    batch.keys = setup.keys.data() + 2 * first;
    batch.episodes = episodes.data();
    batch.rows = rows.data();
    batch.draw_table = setup.description.draws;
    batch.drawn = drawn.data();
    batch.changes = changes.data();
    batch.num_changes = changes.size();
  }

  double& at(long long row, long long i) { return world[row * lanes + i]; }

  // Whether the step resolves the motion of a plant, as `check_step` of contract.py.
  bool resolves(long long i, double M, double mu) {
    const auto& [settings, layout, entries, draws] = setup.description;
    const Options& o = setup.options;
    Constants<double> p;
    for (int n = 0; n < NUM_CONSTANTS; n++)
      (&p.m)[n] =
          settings.varied != 0.0 ? drawn[(layout.constant_draws + n) * count + i] : (&o.m)[n];
    p.motor_friction += o.disturbances_motor_friction.high;
    return fastest_rate(p, M, mu, o.paper_normal_force) * settings.physics_dt <= STABLE;
  }

  bool begin() {
    CHECK(draw_episodes(batch, count) == -1);
    for (size_t k = 0; k < setup.state.size(); k++)
      for (long long i = 0; i < count; i++) drawn[k * count + i] = setup.state[k];
    if (lanes == 1) begin_episodes<1>(batch, count);
    else begin_episodes<LANES>(batch, count);
    for (long long i = 0; i < count; i++)
      if (!resolves(i, at(ROW_OF(M), i), at(ROW_OF(mu), i))) return false;
    for (const Change& change : changes)
      if (!resolves((long long)change.environment, change.M, change.mu)) return false;
    return works(advance(batch, 0, count, true));
  }

  bool step(double action) {
    for (long long i = 0; i < count; i++) {
      at(ROW_OF(action), i) = action;
      at(ROW_OF(active), i) = at(ROW_OF(termination), i) == 0.0;
    }
    return works(advance(batch, 0, count, false));
  }

  bool works(long long broken) {
    CHECK(broken == -1 || setup.choice.law != 0);
    return broken == -1;
  }

  void check() {
    const auto& [settings, layout, entries, draws] = setup.description;
    for (long long i = 0; i < count; i++) {
      for (long long row = 0; row < ROW_OF(mass_ratio); row++)
        CHECK(row == ROW_OF(smallest_normal_ratio) || std::isfinite(at(row, i)));
      CHECK(std::fabs(at(ROW_OF(torque), i)) <= settings.torque_limit);
      for (long long k = 0; k < layout.entries; k++) {
        float shown = observations[i * layout.entries + k];
        CHECK(shown >= (float)entries[k].low && shown <= (float)entries[k].high);
      }
      check_metrics(i);
    }
  }

  void check_metrics(long long i) {
    double found[64];
    if (lanes == 1) episode_metrics<1>(batch, &rows[i], 1, 33.0, found);
    else episode_metrics<LANES>(batch, &rows[i], 1, 33.0, found);
    // Distance and energy, whose sums must not overflow.
    CHECK(std::isfinite(found[0]) && std::isfinite(found[9]) && std::isfinite(found[10]));
  }

  // Whether the environment i has the bits of one that is alone.
  bool equals(long long i, Simulation& alone) {
    long long entries = setup.description.layout.entries;
    const float* shown = observations.data() + i * entries;
    if (std::memcmp(shown, alone.observations.data(), entries * sizeof(float))) return false;
    for (long long row = 0; row < ROW_OF(active); row++)
      if (std::memcmp(&at(row, i), &alone.at(row, 0), sizeof(double))) return false;
    return true;
  }
};

void run(Input& in, const Setup& setup, long long count) {
  Simulation batch(setup, 0, count, LANES);
  std::vector<std::unique_ptr<Simulation>> alone;
  bool works = batch.begin();
  for (long long i = 0; i < count; i++) {
    alone.push_back(std::make_unique<Simulation>(setup, i, 1, 1));
    works &= alone[i]->begin();
  }
  for (int step = 0; works && step < MOST_STEPS; step++) {
    batch.check();
    for (long long i = 0; i < count; i++) CHECK(batch.equals(i, *alone[i]));
    if (in.bytes.remaining_bytes() == 0) return;
    double action = in.flag() ? in.number(0.5, -1.0, 1.0) : in.whole(-1, 1);
    works = batch.step(action);
    for (long long i = 0; i < count; i++) works &= alone[i]->step(action);
  }
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  Input in = {{data, size}};
  Setup setup = {};
  Options& o = setup.options;
  choose_options(in, o, setup.choice);
  Settings settings = make_settings(o);
  if (!divides(o, settings)) return 0;
  if (!solvable(o, range_of(o.M_range, o.M).low, range_of(o.mu_range, o.mu).high)) return 0;
  long long count = in.whole(1, 3);
  for (long long k = 0; k < 2 * count; k++) setup.keys.push_back(in.whole(0, 1000));
  for (long long i = 0; i < count && in.flag(); i++) {
    Change change = {(double)i, in.number(0.1, 0.0, 1e6), in.number(0.5, SMALLEST, LARGEST),
                     in.number(0.3, 0.0, LARGEST)};
    bool shown = change.M <= settings.M_bound && change.mu <= settings.mu_bound;
    if (solvable(o, change.M, change.mu) && (shown || o.observe_parameters == 0.0))
      setup.changes.push_back(change);
  }
  if (in.flag()) {
    double theta = std::nextafter(THETA_LIMIT, 0.0);
    setup.state = {in.number(0.5, -theta, theta), in.number(5.0, -1e3, 1e3),
                   in.number(0.1, -1e6, 1e6), in.number(0.5, -1e3, 1e3)};
  }
  auto allocate = [](size_t bytes) { return __builtin_malloc(bytes); };
  CHECK(describe_environment(o, setup.description, allocate));
  if (setup.description.layout.rows <= MOST_ROWS) run(in, setup, count);
  __builtin_free(setup.description.entries);
  return 0;
}
