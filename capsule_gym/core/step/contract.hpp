// What follows from the options of an environment: the settings of the step, the rows of an
// environment, the entries of its observation, and the numbers that an episode draws. Python and
// JavaScript ask for them, and compute none again.
#pragma once
#include "metrics.hpp"
#include "observation.hpp"

namespace LEVEL {
// The options by the names of `EnvConfig`, `Capsule`, `Randomization` and `Disturbances`; SI units.
// NaN stands for one that is not given, conditions are 0.0 or 1.0. A range is its ends.
#define CAPSULE_OPTIONS(OPTION, RANGE, DISTURBANCE)                                                \
  OPTION(torque_limit)                                                                             \
  OPTION(residual_limit)                                                                           \
  OPTION(total_torque)                                                                             \
  OPTION(control_dt)                                                                               \
  OPTION(physics_dt)                                                                               \
  OPTION(energy_weight) OPTION(termination_penalty) OPTION(observe_parameters)                     \
      OPTION(observe_estimates) OPTION(stack_size) OPTION(goal_env) OPTION(initial_noise)          \
          OPTION(initial_theta)                                                                    \
              OPTION(initial_theta_dot) /* The number of the task, and the range that its          \
                                           episodes draw instead of its own. */                    \
      OPTION(task) RANGE(task) /* The controller: whether there is one, its period, and the sizes  \
                                  of its memory and of a row of its reference. */                  \
      OPTION(controller) OPTION(law_dt) OPTION(memory_size)                                        \
          OPTION(reference_size) /* The capsule, and the ranges of the randomization. */           \
      OPTION(M) OPTION(mu) CAPSULE_CONSTANTS(OPTION) OPTION(paper_normal_force) RANGE(M) RANGE(mu) \
          OPTION(log_mu)                                                                           \
              CAPSULE_CONSTANTS(RANGE) /* The disturbances: whether there are any, what they draw, \
                                          and whether law and agent observe the sensors. */        \
      OPTION(disturbed) CAPSULE_DISTURBANCES(DISTURBANCE) OPTION(law_observes)                     \
          OPTION(agent_observes) OPTION(with_theta) OPTION(with_theta_dot) OPTION(with_x_dot)      \
              OPTION(stick_threshold) OPTION(x_noise)
#define CAPSULE_RANGE(name) Range name##_range;
#define CAPSULE_RANGE_NAMES(name) #name "_low " #name "_high "
#define CAPSULE_DISTURBANCE(name) Range disturbances_##name;
#define CAPSULE_DISTURBANCE_NAMES(name) "disturbances_" #name "_low disturbances_" #name "_high "
struct Options {
  CAPSULE_OPTIONS(CAPSULE_DOUBLE, CAPSULE_RANGE, CAPSULE_DISTURBANCE)
};

// s: the agent's step for which a task counts the steps of an episode; the integrator's step
// without and with a law.
constexpr double CONTROL_DT = 2e-2;
constexpr double DIRECT_PHYSICS_DT = 2e-3, LAW_PHYSICS_DT = 1e-3;
constexpr double MOST_SUBSTEPS =
    1e6;  // integrator steps per agent step, which take a tenth of a second
constexpr double START_THETA = -PI / 3.0;
// Bounds of the observed M, in masses of the capsule's platform, and of mu; wider ranges extend
// them.
constexpr double M_BOUND = 4.0, MU_BOUND = 1.0;
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

// The values and the ranges of the plant's constants.
inline const Constants<double>& constants_of(const Options& o) {
  return (const Constants<double>&)o.m;
}
constexpr int NUM_CONSTANTS = WIDTH<Constants<double>>,
              NUM_DISTURBANCES = WIDTH<Disturbances<double>>;

inline Settings make_settings(const Options& o) {
  Settings q = {};
  bool law = o.controller != 0.0, disturbed = o.disturbed != 0.0, varied = disturbed;
  for (int n = 0; n < NUM_CONSTANTS; n++) varied |= is_given((&o.m_range)[n].low);
  q.torque_limit = o.torque_limit;
  q.residual_limit = is_given(o.residual_limit) ? o.residual_limit : o.torque_limit;
  q.total_torque = o.total_torque;
  double usual = law ? LAW_PHYSICS_DT : DIRECT_PHYSICS_DT;
  q.physics_dt = is_given(o.physics_dt) ? o.physics_dt : usual;
  // A latency, and a motor's lag, need a shorter period than an agent's step.
  double direct_dt = varied ? q.physics_dt : o.control_dt;
  q.law_dt = law ? o.law_dt : direct_dt;
  q.physics_steps = count_of(q.law_dt, q.physics_dt);
  q.law_steps = count_of(o.control_dt, q.law_dt);
  q.energy_weight = o.energy_weight;
  q.termination_penalty = o.termination_penalty;
  q.with_reference = o.controller;
  q.with_parameters = o.observe_parameters;
  q.with_estimates = o.observe_estimates;
  q.with_task = o.goal_env == 0.0;
  q.stack_size = o.stack_size;
  q.M_bound = max(M_BOUND * o.M, ROOM * range_of(o.M_range, o.M).high);
  q.mu_bound = max(MU_BOUND, ROOM * range_of(o.mu_range, o.mu).high);
  q.varied = varied;
  q.with_theta = q.with_theta_dot = q.with_x_dot = 1.0;
  if (varied) {
    q.history_states = 1.0 - floor(-(o.disturbances_latency.high / q.law_dt));
    // The length of the history; its product may be a rounding error below the latency that it is
    // for.
    q.longest_latency = (q.history_states - 1.0) * q.physics_steps * q.physics_dt * (1.0 + 1e-9);
  }
  if (disturbed) {
    q.law_reads = law && o.law_observes != 0.0;
    q.agent_reads = o.agent_observes;
    q.with_theta = o.with_theta;
    q.with_theta_dot = o.with_theta_dot;
    q.with_x_dot = o.with_x_dot;
    q.with_x = is_given(o.x_noise);
    q.x_noise = is_given(o.x_noise) ? o.x_noise : 0.0;
    q.stick_threshold = o.stick_threshold;
  }
  auto p = derive(constants_of(o));
  q.pivot_torque_on_contact = o.paper_normal_force;
  q.extended = o.paper_normal_force != 0.0 || is_extended(constants_of(o));
#define FIELD(name) q.name = p.name;
  CAPSULE_PLANT(FIELD)
#undef FIELD
  return q;
}

// Puts the entries of an observation, the newest first, as put(name, steps ago, low, high).
template <class Task, class Put> void describe_entries(const Settings& q, Put put) {
  Observed<double> observed = {};
  typename Task::template Memory<double> memory = {};
  for (int age = 0; age < (int)q.stack_size; age++)
    put_entries<Task>(
        q, observed, memory,
        [&](const char* name, double low, double high, double) { put(name, age, low, high); },
        [] { return Estimator<double>{}; });
}

template <class Task> Layout make_layout(const Options& o, const Settings& q) {
  Layout l = {};
  long long task_size = WIDTH<typename Task::template Memory<double>>;
  l.law_memory = NUM_ROWS;
  l.reference = l.law_memory + (long long)o.memory_size;
  l.reference_end = l.reference + (long long)o.reference_size;
  bool measured_first = q.law_reads != 0.0;
  l.task = l.reference_end + (measured_first ? task_size : 0);
  l.task_end = l.task + task_size;
  l.read_task = measured_first ? l.reference_end : l.task_end;
  l.history = l.reference_end + (q.varied != 0.0 ? 2 : 1) * task_size;
  l.estimator = l.history + HISTORY_ROWS * (long long)q.history_states;
  l.rows = l.estimator + (q.with_estimates != 0.0 ? ESTIMATOR_CELLS : 0);
  describe_entries<Task>(q, [&](const char*, int, double, double) { l.entries++; });
  constexpr int START_DRAWS = WIDTH<State<double>>, PLANT_DRAWS = 2;
  l.task_draws = START_DRAWS + PLANT_DRAWS;
  l.constant_draws = l.task_draws;
  Task::draws(o.task_range, [&](const char*, double, double, double) { l.constant_draws++; });
  l.disturbance_draws = l.constant_draws + (q.varied != 0.0 ? NUM_CONSTANTS : 0);
  l.draws = l.disturbance_draws + (q.varied != 0.0 ? NUM_DISTURBANCES + 1 : 0);
  l.steps = (long long)rounded(Task::STEPS * CONTROL_DT / o.control_dt, 1.0);
  return l;
}

// Writes the `l.draws` lines of the draw table: the initial state, M and mu, those of the task, and
// those of varied plants. There are always two numbers for M and mu, so that ranges do not shift
// the stream.
template <class Task>
void make_draws(const Options& o, const Settings& q, const Layout& l, Draw* next) {
  auto put = [&](long long row, Stream stream, int place, Range range, double distribution) {
    *next++ = {(double)row, (double)stream,         (double)place,
               range.low,   range.high - range.low, distribution};
  };
  auto put_state = [&](int row, double middle, double half_width) {
    *next++ = {(double)row, (double)Stream::initial_state, (double)row, middle, half_width,
               CENTRED};
  };
  bool wide = is_given(o.initial_theta);
  put_state(ROW_OF(theta), wide ? 0.0 : START_THETA, wide ? o.initial_theta : o.initial_noise);
  put_state(ROW_OF(theta_dot), 0.0, wide ? o.initial_theta_dot : 0.0);
  put_state(ROW_OF(x), 0.0, 0.0);
  put_state(ROW_OF(x_dot), 0.0, 0.0);
  put(ROW_OF(M), Stream::parameters, 0, range_of(o.M_range, o.M), UNIFORM);
  Range mu = range_of(o.mu_range, o.mu);
  bool logarithmic = is_given(o.mu_range.low) && o.log_mu != 0.0;
  put(ROW_OF(mu), Stream::parameters, 1, mu, UNIFORM);
  if (logarithmic) {
    next[-1].range = log(mu.high / mu.low);
    next[-1].distribution = LOGARITHMIC;
  }
  long long task_draws = l.constant_draws - l.task_draws, row = l.task_end - task_draws;
  int place = 0;
  Task::draws(o.task_range, [&](const char*, double low, double high, double distribution) {
    put(row++, Stream::task, place++, {low, high}, distribution);
  });
  if (q.varied == 0.0) return;
  row = ROW_OF(drawn_m), place = 0;
  for (int n = 0; n < NUM_CONSTANTS; n++)
    put(row++, Stream::variation, place++, range_of((&o.m_range)[n], (&o.m)[n]), UNIFORM);
  for (int n = 0; n < NUM_DISTURBANCES; n++)
    put(row++, Stream::variation, place++, (&o.disturbances_theta_noise)[n], UNIFORM);
  put(row, Stream::variation, place, {0.0, LARGEST_KEY}, UNIFORM);
}
}  // namespace LEVEL
