// How the numbers of environments lie in memory: blocks of N environments, one row per quantity.
// The lists of names are written here once; Python sees the same names.
#pragma once
#include "../estimator.hpp"
#include "../physics/plant.hpp"
#include "disturbances.hpp"

// The quantities of an environment; SI units. `info` shows the first ones under these names.
#define CAPSULE_ROWS                                                                               \
  ROW(theta)                                                                                       \
  ROW(theta_dot)                                                                                   \
  ROW(x)                                                                                           \
  ROW(x_dot)                                                                                       \
  ROW(M)                                                                                           \
  ROW(mu) ROW(torque) ROW(law_torque) ROW(normal_force) ROW(energy) ROW(reward_progress)           \
      ROW(reward_energy)                                                                           \
          ROW(reward_termination) /* 1.0 where the last step came close to a termination. */       \
      ROW(cost)                   /* The result of the agent step. */                              \
      ROW(reward) ROW(termination)                                                                 \
          ROW(steps) /* Sums and extreme values of the episode. weight_distance is the distance    \
                        weighted with (M + m) g, J: the denominator of the cost of transport, also \
                        where M changes on the way. */                                             \
      ROW(start_x) ROW(duration) ROW(episode_energy) ROW(weight_distance) ROW(torque_squared)      \
          ROW(peak_torque) ROW(forward) ROW(backward) ROW(stuck) ROW(smallest_normal_ratio)        \
              ROW(largest_theta)                                                                   \
                  ROW(largest_theta_dot) /* Row of the reference that the law has seen last. */    \
      ROW(clock) /* Input of the step: the action, and 1.0 where the environment takes part. */    \
      ROW(action)                                                                                  \
          ROW(active) /* Of the running step: m / (M + m), x at its start, how far the environment \
                         has stopped, and the time that its present torque has acted. */           \
      ROW(mass_ratio) ROW(before_x) ROW(halt)                                                      \
          ROW(elapsed) /* Written only where a substep has an event: its end if the phase lasted,  \
                          the accelerations at its start. */                                       \
      ROW(next_theta) ROW(next_theta_dot) ROW(next_x) ROW(next_x_dot) ROW(theta_ddot) ROW(x_ddot)  \
          ROW(first_normal_force) ROW(                                                             \
              least_normal_force) /* Down to the end only for varied plants. The constants of      \
                                     `Plant`, those that the episode has drawn, its disturbances   \
                                     as in `Disturbances`, and the key of its noise. */            \
      CAPSULE_PLANT(PLANT_ROW) CAPSULE_CONSTANTS(DRAWN) CAPSULE_DISTURBANCES(ROW)                  \
          ROW(key) /* Derived: the latency in periods, the shares of drift and of motor lag after  \
                      one period. */                                                               \
      ROW(delay) ROW(drift_share) ROW(                                                             \
          motor_share) /* In the first lane: the entry of the history that was written last. */    \
      ROW(cursor) /* From here on zeros at the start of an episode. Readings so far; the motor's   \
                     torque, N m; each sensor's drift. */                                          \
      ROW(readings) ROW(motor) ROW(drift_of_theta) ROW(drift_of_theta_dot)                         \
          ROW(drift_of_x_dot) /* The last reading; x is the integral of its x_dot, or that of a    \
                                 sensor. */                                                        \
      ROW(read_theta) ROW(read_theta_dot) ROW(read_x)                                              \
          ROW(read_x_dot) /* The state that the next reading shows. */                             \
      ROW(late_theta) ROW(late_theta_dot) ROW(late_x)                                              \
          ROW(late_x_dot) /* The measured x at the start of the agent step. */                     \
      ROW(read_before_x)
#define PLANT_ROW(name) ROW(plant_##name)
#define DRAWN(name) ROW(drawn_##name)

// Environments of a block in a batch: those with an event in a substep fill whole registers, and
// the rows of a step fit into a cache. One environment alone is a block of one lane, so that its
// rows lie side by side.
constexpr int LANES = 128;
constexpr int MOST_CELLS = 256;  // largest number of cells in the memory of a law

template <int N> struct Block {
#define ROW(name) double name[N];
  CAPSULE_ROWS
#undef ROW
};

// The number of a row, and that of all rows above.
#define ROW_OF(name) ((long long)(__builtin_offsetof(Block<1>, name) / sizeof(double)))
constexpr long long NUM_ROWS = sizeof(Block<1>) / sizeof(double);

// Reasons for the termination of an episode: the ball meets the platform, the platform leaves the
// floor, the integrator cannot resolve the motion.
#define CAPSULE_TERMINATIONS "none pendulum contact diverged "
enum Termination { NONE, PENDULUM, CONTACT, DIVERGED };

// For blocks: a loop over their lanes, a register at a time, and reads and writes of a row at the
// lanes from j on.
#define EACH for (int j = 0; j < n; j += WIDTH<T>)
#define GET(row) load<T>(b.row + j)
#define PUT(row, value) store<T>(b.row + j, value)
// The rows from this one on, whose numbers are the fields of a struct.
#define FROM(row) ((double*)&b + __builtin_offsetof(Block<N>, row) / sizeof(double))

// Values of the row `halt`: under way; stopped in the present substep, with one call of the law
// left; and halted.
constexpr double UNDER_WAY = 0.0, ENDING = 1.0, HALTED = 2.0;
constexpr int HISTORY_ROWS = LEVEL::WIDTH<LEVEL::State<double>>;  // of each state in the history
constexpr int ESTIMATOR_CELLS =
    LEVEL::WIDTH<LEVEL::Estimator<double>>;  // only with observed estimates

// The settings of a step, SI units; conditions are 0.0 or 1.0.
#define CAPSULE_SETTINGS(FIELD)                                                                    \
  FIELD(torque_limit)                                                                              \
  FIELD(residual_limit)                                                                            \
  FIELD(total_torque)                                                                              \
  FIELD(physics_dt)                                                                                \
  FIELD(physics_steps)                                                                             \
  FIELD(law_steps) FIELD(energy_weight) FIELD(termination_penalty) FIELD(with_reference)           \
      FIELD(with_parameters) FIELD(with_estimates) FIELD(with_task)                                \
          FIELD(stack_size)          /* Bounds of the observed M, kg, and mu. */                   \
      FIELD(M_bound) FIELD(mu_bound) /* Period of the law, s; without a law that of the agent, or  \
                                        of the integrator where plants vary. */                    \
      FIELD(law_dt) /* Disturbances: number of states in the history, whether law and agent        \
                       observe the sensors, the sensors that exist, the noise of that of x, the    \
                       measured speed up to which the platform counts as at rest, and the latency  \
                       up to which the history reaches. */                                         \
      FIELD(history_states) FIELD(law_reads) FIELD(agent_reads) FIELD(with_theta)                  \
          FIELD(with_theta_dot) FIELD(with_x_dot) FIELD(with_x) FIELD(x_noise)                     \
              FIELD(stick_threshold)                                                               \
                  FIELD(longest_latency) /* The plant: whether it is extended, and differs in more \
                                            than M and mu; and its constants. */                   \
      FIELD(extended) FIELD(varied) FIELD(pivot_torque_on_contact) CAPSULE_PLANT(FIELD)

struct Settings {
  CAPSULE_SETTINGS(CAPSULE_DOUBLE)

  // The time of an agent step, s.
  double control_dt() const { return law_steps * physics_steps * physics_dt; }
};

// The first rows of the parts of an environment behind its quantities, and the sizes that follow
// from its options.
#define CAPSULE_LAYOUT(FIELD)                                                                      \
  /* The law's memory, its line of the reference, and one past its end. A law of a task reads the  \
   * memory there. */                                                                              \
  FIELD(law_memory)                                                                                \
  FIELD(reference)                                                                                 \
  FIELD(reference_end) /* The task's memory with true values, one past its end,                    \
                          and for varied plants that with measured values, which                   \
                          comes first where the law observes the sensors. */                       \
  FIELD(task)                                                                                      \
  FIELD(task_end)                                                                                  \
  FIELD(read_task) /* The last states of a varied plant, the                                       \
                      estimator, and the number of all rows. */                                    \
  FIELD(history)                                                                                   \
  FIELD(estimator) FIELD(rows) /* Entries of the observation. Lines of the draw table: all of      \
                                  them, the first one of the task, of the constants and of the                                                \
                                  disturbances. Agent steps of a whole episode. */                                                                      \
      FIELD(entries) FIELD(draws) FIELD(task_draws) FIELD(constant_draws) FIELD(disturbance_draws) \
          FIELD(steps)
#define CAPSULE_WHOLE(name) long long name;
struct Layout {
  CAPSULE_LAYOUT(CAPSULE_WHOLE)

  long long memory_size() const { return reference - law_memory; }
  long long reference_size() const { return reference_end - reference; }
};

// Calls a law that is not part of the core for n environments of a block whose rows begin at
// `block`: replaces their memory and the torques, which are NaN, but for environments where the law
// raises an exception. Where the law observes the sensors, its state is the rows from read_theta
// on.
typedef void (*UserLaw)(void* data, double* block, double* torques, long long n);

// The purposes of random numbers. Each has its own stream, so that draws for one do not shift
// another.
#define CAPSULE_STREAMS(STREAM) \
  STREAM(parameters) STREAM(initial_state) STREAM(disturbances) STREAM(task) STREAM(variation)
#define STREAM_PLACE(name) name,
enum class Stream { CAPSULE_STREAMS(STREAM_PLACE) };

// A number that an episode draws: its row in the world, the stream and the place of its share in
// [0, 1) there, and its distribution.
struct Draw {
  double row, stream, place, low, range, distribution;
};

// Everything that belongs to the environments of a simulation: arrays, by their addresses, and
// their sizes. Python passes the address of an array of these numbers.
#define CAPSULE_BATCH(FIELD)                                                                      \
  /* The blocks, of `layout.rows` rows; `lanes` is LANES or 1. */                                 \
  FIELD(double*, world)                                                                           \
  FIELD(long long, num_envs)                                                                      \
  FIELD(long long, lanes)                                                                         \
  FIELD(float*, observations)                                                                     \
  FIELD(const Settings*, settings)                                                                \
  FIELD(const Layout*, layout) /* Numbers of the task and of the law in their lists. */           \
  FIELD(long long, task)                                                                          \
  FIELD(long long, law) FIELD(const double*, law_constants) FIELD(UserLaw, user_law) FIELD(       \
      void*, user_data) /* The law's memory at the start of an episode, and its reference. */     \
      FIELD(const double*, memory) FIELD(const double*, reference) FIELD(                         \
          long long, reference_rows) /* Resets: keys (num_envs, 2), episodes since the seeding,   \
                                        the environments that begin (count,), what they draw, and \
                                        the values (layout.draws, num_envs). */                   \
      FIELD(const unsigned long long*, keys) FIELD(long long*, episodes)                          \
          FIELD(const long long*, rows) FIELD(const Draw*, draw_table)                            \
              FIELD(double*, drawn) /* Rows of environment, time (s), M (kg) and mu, in order of  \
                                       environment and time. */                                   \
      FIELD(const double*, changes) FIELD(long long, num_changes)

struct Batch {
#define FIELD(type, name) type name;
  CAPSULE_BATCH(FIELD)
#undef FIELD
};

// The block of N environments that holds environment i.
template <int N> INLINE Block<N>& block_of(const Batch& batch, long long i) {
  return *(Block<N>*)(batch.world + i / N * batch.layout->rows * N);
}
