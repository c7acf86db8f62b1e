// What follows from the options of an environment: the settings of the step, the rows of an
// environment, the entries of its observation, and the numbers that an episode draws. Python and
// JavaScript ask for them, and compute none again.
#pragma once
#include "metrics.hpp"
#include "observation.hpp"

namespace LEVEL {
// The options by the names of `EnvConfig`, `Capsule`, `Randomization` and `Disturbances`; SI units.
// NaN stands for one that is not given, conditions are 0.0 or 1.0. A range is its ends.
#define CAPSULE_OPTIONS(OPTION, RANGE, DISTURBANCE)                  \
  OPTION(torque_limit)                                               \
  OPTION(residual_limit)                                             \
  OPTION(total_torque)                                               \
  OPTION(control_dt)                                                 \
  OPTION(physics_dt)                                                 \
  OPTION(energy_weight)                                              \
  OPTION(termination_penalty)                                        \
  OPTION(observe_parameters)                                         \
  OPTION(observe_estimates)                                          \
  OPTION(stack_size)                                                 \
  OPTION(goal_env)                                                   \
  OPTION(initial_noise)                                              \
  OPTION(initial_theta)                                              \
  OPTION(initial_theta_dot)                                          \
  OPTION(task) /* its number */                                      \
  RANGE(task)  /* what its episodes draw instead of its own range */ \
  /* The controller. */                                              \
  OPTION(controller) /* whether there is one */                      \
  OPTION(law_dt)                                                     \
  OPTION(memory_size)                                                \
  OPTION(reference_size) /* of a row */                              \
  /* The capsule, and the ranges of the randomization. */            \
  OPTION(M)                                                          \
  OPTION(mu)                                                         \
  CAPSULE_CONSTANTS(OPTION)                                          \
  OPTION(paper_normal_force)                                         \
  RANGE(M)                                                           \
  RANGE(mu)                                                          \
  OPTION(log_mu)                                                     \
  CAPSULE_CONSTANTS(RANGE)                                           \
  /* The disturbances. */                                            \
  OPTION(disturbed) /* whether there are any */                      \
  CAPSULE_DISTURBANCES(DISTURBANCE)                                  \
  OPTION(law_observes) /* the sensors */                             \
  OPTION(agent_observes)                                             \
  OPTION(with_theta)                                                 \
  OPTION(with_theta_dot)                                             \
  OPTION(with_x_dot)                                                 \
  OPTION(stick_threshold)                                            \
  OPTION(x_noise)
#define CAPSULE_RANGE(name) Range name##_range;
#define CAPSULE_RANGE_NAMES(name) #name "_low " #name "_high "
#define CAPSULE_DISTURBANCE(name) Range disturbances_##name;
#define CAPSULE_DISTURBANCE_NAMES(name) "disturbances_" #name "_low disturbances_" #name "_high "
struct Options {
  CAPSULE_OPTIONS(CAPSULE_DOUBLE, CAPSULE_RANGE, CAPSULE_DISTURBANCE)
};

// The agent's step for which a task counts the steps of an episode, s.
constexpr double CONTROL_DT = 2e-2;
// The integrator's longest default step without and with a law, s.
constexpr double DIRECT_PHYSICS_DT = 2e-3;
constexpr double LAW_PHYSICS_DT = 1e-3;
// Integrator steps per agent step, which take a tenth of a second.
constexpr double MOST_SUBSTEPS = 1e6;
constexpr double START_THETA = -PI / 3.0;
// Bounds of the observed M, in masses of the capsule's platform, and of mu; wider ranges extend
// them.
constexpr double M_BOUND = 4.0;
constexpr double MU_BOUND = 1.0;
// For the rounding of a draw, and of the observation to float32.
constexpr double ROOM = 1.0 + 1e-6;
// Upper limit of the keys of an episode's noise; doubles represent all whole numbers up to it
// exactly.
constexpr double LARGEST_KEY = 9007199254740992.0;

inline bool is_given(double option) { return option == option; }
// The range, or both ends at the value where the range is not given.
inline Range range_of(Range range, double value) {
  return is_given(range.low) ? range : Range{value, value};
}
// The number of times that a part fits into the whole, which Python and JavaScript check.
inline double count_of(double whole, double part) {
  return (min(whole / part, 2.0 * MOST_SUBSTEPS) + ROUNDING) - ROUNDING;
}

// The longest step up to `longest` that divides the period.
inline double usual_step(double period, double longest) {
  double count = period / longest;
  double whole = count_of(period, longest);
  bool divides = whole >= 1.0 && abs(count - whole) <= 1e-9 * whole;
  return divides ? longest : period / -floor(-count);
}

// The values of the plant's constants, whose ranges follow each other from `m_range` on.
inline const Constants<double>& constants_of(const Options& o) {
  return (const Constants<double>&)o.m;
}
constexpr int NUM_CONSTANTS = WIDTH<Constants<double>>;
constexpr int NUM_DISTURBANCES = WIDTH<Disturbances<double>>;
constexpr int NUM_SAMPLING = WIDTH<Sampling<double>>;

inline bool varies_constants(const Options& o) {
  for (int n = 0; n < NUM_CONSTANTS; n++)
    if (is_given((&o.m_range)[n].low)) return true;
  return false;
}

inline void set_times(Settings& settings, const Options& o) {
  bool law = o.controller != 0.0;
  double usual =
      law ? usual_step(o.law_dt, LAW_PHYSICS_DT) : usual_step(o.control_dt, DIRECT_PHYSICS_DT);
  settings.physics_dt = is_given(o.physics_dt) ? o.physics_dt : usual;
  // A latency, and a motor's lag, need a shorter period than an agent's step.
  double direct_dt = settings.varied != 0.0 ? settings.physics_dt : o.control_dt;
  settings.law_dt = law ? o.law_dt : direct_dt;
  settings.physics_steps = count_of(settings.law_dt, settings.physics_dt);
  settings.law_steps = count_of(o.control_dt, settings.law_dt);
}

inline void set_sensors(Settings& settings, const Options& o) {
  settings.law_reads = o.controller != 0.0 && o.law_observes != 0.0;
  settings.agent_reads = o.agent_observes;
  settings.with_theta = o.with_theta;
  settings.with_theta_dot = o.with_theta_dot;
  settings.with_x_dot = o.with_x_dot;
  settings.with_x = is_given(o.x_noise);
  settings.x_noise = is_given(o.x_noise) ? o.x_noise : 0.0;
  settings.stick_threshold = o.stick_threshold;
}

// The history of varied plants.
inline void set_history(Settings& settings, const Options& o) {
  double dt = settings.physics_steps * settings.physics_dt;
  // Whole periods up to the longest delay of a range, and this delay; the product may be a rounding
  // error below the one that it is for.
  auto reach = [&](Range range, double& longest) {
    double periods = -floor(-(range.high / settings.law_dt));
    longest = periods * dt * (1.0 + 1e-9);
    return periods;
  };
  double theta = reach(o.disturbances_theta_latency, settings.longest_theta_latency);
  double theta_dot = reach(o.disturbances_theta_dot_latency, settings.longest_theta_dot_latency);
  double x_dot = reach(o.disturbances_x_dot_latency, settings.longest_x_dot_latency);
  double common = reach(o.disturbances_latency, settings.longest_latency);
  double jitter = reach(o.disturbances_jitter, settings.longest_jitter);
  settings.history_states = 1.0 + common + max(theta, max(theta_dot, x_dot)) + jitter;
}

inline Settings make_settings(const Options& o) {
  Settings settings = {};
  bool disturbed = o.disturbed != 0.0;
  settings.varied = disturbed || varies_constants(o);
  settings.torque_limit = o.torque_limit;
  settings.residual_limit = is_given(o.residual_limit) ? o.residual_limit : o.torque_limit;
  settings.total_torque = o.total_torque;
  set_times(settings, o);
  settings.energy_weight = o.energy_weight;
  settings.termination_penalty = o.termination_penalty;
  settings.with_reference = o.controller;
  settings.with_parameters = o.observe_parameters;
  settings.with_estimates = o.observe_estimates;
  settings.with_task = o.goal_env == 0.0;
  settings.stack_size = o.stack_size;
  settings.M_bound = max(M_BOUND * o.M, ROOM * range_of(o.M_range, o.M).high);
  settings.mu_bound = max(MU_BOUND, ROOM * range_of(o.mu_range, o.mu).high);
  settings.with_theta = 1.0;
  settings.with_theta_dot = 1.0;
  settings.with_x_dot = 1.0;
  if (settings.varied != 0.0) set_history(settings, o);
  if (disturbed) set_sensors(settings, o);
  auto plant = derive(constants_of(o));
  settings.pivot_torque_on_contact = o.paper_normal_force;
  settings.extended = o.paper_normal_force != 0.0 || is_extended(constants_of(o));
#define FIELD(name) settings.name = plant.name;
  CAPSULE_PLANT(FIELD)
#undef FIELD
  return settings;
}

// Puts the entries of an observation, the newest first, as put(name, steps ago, low, high).
template <class Task> void describe_entries(const Settings& settings, auto put) {
  Observed<double> observed = {};
  typename Task::template Memory<double> memory = {};
  for (int age = 0; age < (int)settings.stack_size; age++) {
    auto put_entry = [&](const char* name, double low, double high, double) {
      put(name, age, low, high);
    };
    put_entries<Task>(settings, observed, memory, put_entry, [] { return Estimator<double>{}; });
  }
}

template <class Task> Layout make_layout(const Options& o, const Settings& settings) {
  Layout l = {};
  bool varied = settings.varied != 0.0;
  long long task_size = WIDTH<typename Task::template Memory<double>>;
  l.law_memory = NUM_ROWS;
  l.reference = l.law_memory + (long long)o.memory_size;
  l.reference_end = l.reference + (long long)o.reference_size;
  bool measured_first = settings.law_reads != 0.0;
  l.task = l.reference_end + (measured_first ? task_size : 0);
  l.task_end = l.task + task_size;
  l.read_task = measured_first ? l.reference_end : l.task_end;
  l.history = l.reference_end + (varied ? 2 : 1) * task_size;
  l.estimator = l.history + HISTORY_ROWS * (long long)settings.history_states;
  l.rows = l.estimator + (settings.with_estimates != 0.0 ? ESTIMATOR_CELLS : 0);
  describe_entries<Task>(settings, [&](const char*, int, double, double) { l.entries++; });
  constexpr int START_DRAWS = WIDTH<State<double>>;
  constexpr int PLANT_DRAWS = 2;
  l.task_draws = START_DRAWS + PLANT_DRAWS;
  l.constant_draws = l.task_draws;
  Task::draws(o.task_range, [&](const char*, double, double, double) { l.constant_draws++; });
  l.disturbance_draws = l.constant_draws + (varied ? NUM_CONSTANTS : 0);
  l.draws = l.disturbance_draws + (varied ? NUM_DISTURBANCES + 1 : 0);
  l.steps = (long long)rounded(Task::STEPS * CONTROL_DT / o.control_dt, 1.0);
  return l;
}

// Writes the lines of the draw table one after the other.
struct DrawWriter {
  Draw* next;

  void put(long long row, Stream stream, int place, Range range, double distribution) {
    *next++ = {(double)row, (double)stream,         (double)place,
               range.low,   range.high - range.low, distribution};
  }

  void put_state(int row, double middle, double half_width) {
    *next++ = {(double)row, (double)Stream::initial_state, (double)row, middle, half_width,
               CENTRED};
  }

  void put_start(const Options& o) {
    bool wide = is_given(o.initial_theta);
    put_state(ROW_OF(theta), wide ? 0.0 : START_THETA, wide ? o.initial_theta : o.initial_noise);
    put_state(ROW_OF(theta_dot), 0.0, wide ? o.initial_theta_dot : 0.0);
    put_state(ROW_OF(x), 0.0, 0.0);
    put_state(ROW_OF(x_dot), 0.0, 0.0);
  }

  // There are always two numbers, so that ranges do not shift the stream.
  void put_parameters(const Options& o) {
    put(ROW_OF(M), Stream::parameters, 0, range_of(o.M_range, o.M), UNIFORM);
    Range mu = range_of(o.mu_range, o.mu);
    put(ROW_OF(mu), Stream::parameters, 1, mu, UNIFORM);
    bool logarithmic = is_given(o.mu_range.low) && o.log_mu != 0.0;
    if (logarithmic) {
      next[-1].range = log(mu.high / mu.low);
      next[-1].distribution = LOGARITHMIC;
    }
  }

  void put_variation(const Options& o) {
    long long row = ROW_OF(drawn_m);
    int place = 0;
    auto put_uniform = [&](Range range) { put(row++, Stream::variation, place++, range, UNIFORM); };
    for (int n = 0; n < NUM_CONSTANTS; n++) put_uniform(range_of((&o.m_range)[n], (&o.m)[n]));
    const Range* disturbances = &o.disturbances_theta_noise;
    for (int n = 0; n < NUM_DISTURBANCES - NUM_SAMPLING; n++) put_uniform(*disturbances++);
    for (int n = 0; n < NUM_SAMPLING; n++)
      put(row++, Stream::sampling, n, *disturbances++, UNIFORM);
    put(ROW_OF(key), Stream::variation, place, {0.0, LARGEST_KEY}, UNIFORM);
  }
};

// Writes the `l.draws` lines of the draw table: the initial state, M and mu, those of the task, and
// those of varied plants.
template <class Task>
void make_draws(const Options& o, const Settings& settings, const Layout& l, Draw* table) {
  DrawWriter writer = {table};
  writer.put_start(o);
  writer.put_parameters(o);
  long long row = l.task_end - (l.constant_draws - l.task_draws);
  int place = 0;
  Task::draws(o.task_range, [&](const char*, double low, double high, double distribution) {
    writer.put(row++, Stream::task, place++, {low, high}, distribution);
  });
  if (settings.varied != 0.0) writer.put_variation(o);
}
}  // namespace LEVEL
