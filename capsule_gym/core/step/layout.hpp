// How the numbers of environments lie in memory: blocks of N environments, one row per quantity.
// The lists of names are written here once; Python sees the same names.
#pragma once
#include "../estimator.hpp"
#include "../physics/plant.hpp"
#include "disturbances.hpp"

// The quantities of an environment; SI units. `info` shows the first ones under these names.
#define CAPSULE_ROWS                                                                             \
  ROW(theta)                                                                                     \
  ROW(theta_dot)                                                                                 \
  ROW(x)                                                                                         \
  ROW(x_dot)                                                                                     \
  ROW(M)                                                                                         \
  ROW(mu)                                                                                        \
  ROW(torque)                                                                                    \
  ROW(law_torque)                                                                                \
  ROW(normal_force)                                                                              \
  ROW(energy)                                                                                    \
  ROW(reward_progress)                                                                           \
  ROW(reward_energy)                                                                             \
  ROW(reward_termination)                                                                        \
  ROW(cost) /* 1.0 where the last step came close to a termination */                            \
  /* The result of the agent step. */                                                            \
  ROW(reward)                                                                                    \
  ROW(termination)                                                                               \
  /* Sums and extreme values of the episode. */                                                  \
  ROW(steps)                                                                                     \
  ROW(start_x)                                                                                   \
  ROW(duration)                                                                                  \
  ROW(episode_energy)                                                                            \
  ROW(weight_distance) /* distance times (M + m) g, J, also where M changes on the way */        \
  ROW(torque_squared)                                                                            \
  ROW(peak_torque)                                                                               \
  ROW(forward)                                                                                   \
  ROW(backward)                                                                                  \
  ROW(stuck)                                                                                     \
  ROW(smallest_normal_ratio)                                                                     \
  ROW(largest_theta)                                                                             \
  ROW(largest_theta_dot)                                                                         \
  ROW(clock) /* row of the reference that the law has seen last */                               \
  /* Input of the step. */                                                                       \
  ROW(action)                                                                                    \
  ROW(active) /* 1.0 where the environment takes part */                                         \
  /* Of the running step. */                                                                     \
  ROW(mass_ratio) /* m / (M + m) */                                                              \
  ROW(before_x)   /* x at its start */                                                           \
  ROW(halt)       /* how far the environment has stopped */                                      \
  ROW(elapsed)    /* time that the present torque has acted, s */                                \
  /* Written only where a substep has an event: its end if the phase lasted, and the */          \
  /* accelerations at its start. */                                                              \
  ROW(next_theta)                                                                                \
  ROW(next_theta_dot)                                                                            \
  ROW(next_x)                                                                                    \
  ROW(next_x_dot)                                                                                \
  ROW(theta_ddot)                                                                                \
  ROW(x_ddot)                                                                                    \
  ROW(first_normal_force)                                                                        \
  ROW(least_normal_force)                                                                        \
  /* Down to the end only for varied plants. The constants of `Plant`, those that the episode */ \
  /* has drawn, its disturbances as in `Disturbances`, and the key of its noise. */              \
  CAPSULE_PLANT(PLANT_ROW)                                                                       \
  CAPSULE_CONSTANTS(DRAWN)                                                                       \
  CAPSULE_DISTURBANCES(ROW)                                                                      \
  /* Periods that a sensor is later than `delay`. */                                             \
  ROW(delay_of_theta)                                                                            \
  ROW(delay_of_theta_dot)                                                                        \
  ROW(delay_of_x_dot)                                                                            \
  ROW(early) /* by which the last reading was taken before its time, s */                        \
  /* What the sensors show until their next sample, and 1.0 where the last reading was lost. */  \
  ROW(sampled_theta)                                                                             \
  ROW(sampled_theta_dot)                                                                         \
  ROW(sampled_x)                                                                                 \
  ROW(sampled_x_dot)                                                                             \
  ROW(lost_theta)                                                                                \
  ROW(lost_theta_dot)                                                                            \
  ROW(lost_x)                                                                                    \
  ROW(lost_x_dot)                                                                                \
  ROW(key)                                                                                       \
  /* Derived: the latency in periods, the shares of drift and of motor lag after one period. */  \
  ROW(delay)                                                                                     \
  ROW(drift_share)                                                                               \
  ROW(motor_share)                                                                               \
  ROW(cursor) /* in the first lane: the entry of the history that was written last */            \
  /* From here on zeros at the start of an episode. */                                           \
  ROW(readings) /* number of readings so far */                                                  \
  ROW(motor)    /* the motor's torque, N m */                                                    \
  ROW(drift_of_theta)                                                                            \
  ROW(drift_of_theta_dot)                                                                        \
  ROW(drift_of_x_dot)                                                                            \
  /* The last reading received; x is the integral of its x_dot, or that of a sensor. */          \
  ROW(read_theta)                                                                                \
  ROW(read_theta_dot)                                                                            \
  ROW(read_x)                                                                                    \
  ROW(read_x_dot)                                                                                \
  /* The state that the next reading shows. */                                                   \
  ROW(late_theta)                                                                                \
  ROW(late_theta_dot)                                                                            \
  ROW(late_x)                                                                                    \
  ROW(late_x_dot)                                                                                \
  ROW(read_before_x) /* the measured x at the start of the agent step */
#define PLANT_ROW(name) ROW(plant_##name)
#define DRAWN(name) ROW(drawn_##name)

// Environments of a block in a batch: those with an event in a substep fill whole registers, and
// the rows of a step fit into a cache. One environment alone is a block of one lane, so that its
// rows lie side by side.
constexpr int LANES = 128;
// Largest number of cells in the memory of a law.
constexpr int MOST_CELLS = 256;

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
// The other lanes keep theirs.
#define PUT_WHERE(condition, row, value) PUT(row, select(condition, T(value), GET(row)))
// The rows from this one on, whose numbers are the fields of a struct.
#define FROM(row) ((double*)&b + __builtin_offsetof(Block<N>, row) / sizeof(double))

// Values of the row `halt`.
constexpr double UNDER_WAY = 0.0;
constexpr double ENDING = 1.0;  // stopped in the present substep, with one call of the law left
constexpr double HALTED = 2.0;

// Rows of each state in the history, and of an estimator.
constexpr int HISTORY_ROWS = LEVEL::WIDTH<LEVEL::State<double>>;
constexpr int ESTIMATOR_CELLS = LEVEL::WIDTH<LEVEL::Estimator<double>>;

// The settings of a step, SI units; conditions are 0.0 or 1.0.
#define CAPSULE_SETTINGS(FIELD)                                                                   \
  FIELD(torque_limit)                                                                             \
  FIELD(residual_limit)                                                                           \
  FIELD(total_torque)                                                                             \
  FIELD(physics_dt)                                                                               \
  FIELD(physics_steps)                                                                            \
  FIELD(law_steps)                                                                                \
  FIELD(energy_weight)                                                                            \
  FIELD(termination_penalty)                                                                      \
  FIELD(with_reference)                                                                           \
  FIELD(with_parameters)                                                                          \
  FIELD(with_estimates)                                                                           \
  FIELD(with_task)                                                                                \
  FIELD(stack_size)                                                                               \
  FIELD(M_bound)  /* of the observed M, kg */                                                     \
  FIELD(mu_bound) /* of the observed mu */                                                        \
  FIELD(                                                                                          \
      law_dt) /* without a law the period of the agent, or of the integrator where plants vary */ \
  /* Disturbances. */                                                                             \
  FIELD(history_states) /* number of states in the history */                                     \
  FIELD(law_reads)      /* whether the law observes the sensors */                                \
  FIELD(agent_reads)    /* whether the agent does */                                              \
  FIELD(with_theta)     /* the sensors that exist */                                              \
  FIELD(with_theta_dot)                                                                           \
  FIELD(with_x_dot)                                                                               \
  FIELD(with_x)                                                                                   \
  FIELD(x_noise)                                                                                  \
  FIELD(stick_threshold) /* measured speed up to which the platform counts as at rest */          \
  /* Up to which the history reaches. */                                                          \
  FIELD(longest_latency)                                                                          \
  FIELD(longest_jitter)                                                                           \
  FIELD(longest_theta_latency)                                                                    \
  FIELD(longest_theta_dot_latency)                                                                \
  FIELD(longest_x_dot_latency)                                                                    \
  /* The plant. */                                                                                \
  FIELD(extended)                                                                                 \
  FIELD(varied) /* whether plants differ in more than M and mu */                                 \
  FIELD(pivot_torque_on_contact)                                                                  \
  CAPSULE_PLANT(FIELD)

struct Settings {
  CAPSULE_SETTINGS(CAPSULE_DOUBLE)

  // The time of an agent step, s.
  double control_dt() const { return law_steps * physics_steps * physics_dt; }
};

// The first rows of the parts of an environment behind its quantities, and the sizes that follow
// from its options.
#define CAPSULE_LAYOUT(FIELD)                                                                   \
  FIELD(law_memory)                                                                             \
  FIELD(reference)     /* the law's line of the reference */                                    \
  FIELD(reference_end) /* a law of a task reads the task's memory from here */                  \
  FIELD(task)          /* the task's memory with true values */                                 \
  FIELD(task_end)                                                                               \
  FIELD(read_task) /* for varied plants that with measured values, first where the law observes \
                      the sensors */                                                            \
  FIELD(history)   /* the last states of a varied plant */                                      \
  FIELD(estimator)                                                                              \
  FIELD(rows)    /* number of all rows */                                                       \
  FIELD(entries) /* of the observation */                                                       \
  /* Lines of the draw table: all of them, and the first one of each part. */                   \
  FIELD(draws)                                                                                  \
  FIELD(task_draws)                                                                             \
  FIELD(constant_draws)                                                                         \
  FIELD(disturbance_draws)                                                                      \
  FIELD(steps) /* agent steps of a whole episode */
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
  STREAM(parameters)            \
  STREAM(initial_state)         \
  STREAM(disturbances)          \
  STREAM(task)                  \
  STREAM(variation)             \
  STREAM(sampling)
#define STREAM_PLACE(name) name,
enum class Stream { CAPSULE_STREAMS(STREAM_PLACE) };

// A number that an episode draws: its row in the world, the stream and the place of its share in
// [0, 1) there, and its distribution.
struct Draw {
  double row, stream, place, low, range, distribution;
};

// A change of M (kg) and mu of an environment during its episode, after `time` s.
struct Change {
  double environment, time, M, mu;
};

// Everything that belongs to the environments of a simulation: arrays, by their addresses, and
// their sizes. Python passes the address of an array of these numbers.
#define CAPSULE_BATCH(FIELD)                                                         \
  FIELD(double*, world) /* the blocks, of `layout.rows` rows */                      \
  FIELD(long long, num_envs)                                                         \
  FIELD(long long, lanes) /* LANES or 1 */                                           \
  FIELD(float*, observations)                                                        \
  FIELD(const Settings*, settings)                                                   \
  FIELD(const Layout*, layout)                                                       \
  FIELD(long long, task) /* its number in the list of tasks */                       \
  FIELD(long long, law)  /* its number in the list of laws */                        \
  FIELD(const double*, law_constants)                                                \
  FIELD(UserLaw, user_law)                                                           \
  FIELD(void*, user_data)                                                            \
  FIELD(const double*, memory) /* of the law at the start of an episode */           \
  FIELD(const double*, reference)                                                    \
  FIELD(long long, reference_rows)                                                   \
  /* Resets. */                                                                      \
  FIELD(const unsigned long long*, keys) /* (num_envs, 2) */                         \
  FIELD(long long*, episodes)            /* number since the seeding */              \
  FIELD(const long long*, rows)          /* (count,): the environments that begin */ \
  FIELD(const Draw*, draw_table)         /* what they draw */                        \
  FIELD(double*, drawn)                  /* (layout.draws, num_envs): the values */  \
  /* In order of environment and time. */                                            \
  FIELD(const Change*, changes)                                                      \
  FIELD(long long, num_changes)

struct Batch {
#define FIELD(type, name) type name;
  CAPSULE_BATCH(FIELD)
#undef FIELD
};

// The block of N environments that holds environment i.
template <int N> INLINE Block<N>& block_of(const Batch& batch, long long i) {
  return *(Block<N>*)(batch.world + i / N * batch.layout->rows * N);
}
