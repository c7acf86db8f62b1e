// Readings of the sensors and the torque of the motor of disturbed environments, over blocks.
#pragma once
#include "layout.hpp"

namespace LEVEL {
// Disturbances of a block of N environments, with the number type T; `history` holds the last
// states.
template <class T, int N> struct Disturbed {
  const Settings& settings;
  Block<N>& b;
  double* history;
  const int n;

  // The period of the law, s, and the time between readings: this period, or without a law the
  // agent's step.
  double period() const { return settings.physics_steps * settings.physics_dt; }
  double time_between_readings() const {
    return settings.with_reference != 0.0 ? period() : period() * settings.law_steps;
  }
  double* entry(int place) const { return history + HISTORY_ROWS * N * place; }
  // Those that the episodes of the lanes from j on have drawn. Field by field, so that none is read
  // that is not used.
  INLINE Disturbances<T> disturbances(int j) const {
#define DRAWN_VALUE(name) GET(name),
    return {CAPSULE_DISTURBANCES(DRAWN_VALUE)};
#undef DRAWN_VALUE
  }

  // Derives the constants of the plants that begin an episode, and fills their history.
  NOINLINE void begin() {
    for (int j = 0; j < n; j++) {
      if (b.active[j] == 0.0) continue;
      derive_plant(j);
      begin_sampling(j);
      b.drift_share[j] = decay(time_between_readings() / b.drift_time[j]);
      double lag = b.lag[j];
      b.motor_share[j] = lag > 0.0 ? 1.0 - decay(period() / lag) : 1.0;
      // The drift begins in its stationary distribution.
      auto [first, second] = normals(word_of(b.key[j], 0.0, 6));
      b.drift_of_theta[j] = b.theta_drift[j] * first;
      b.drift_of_theta_dot[j] = b.theta_dot_drift[j] * second;
      b.drift_of_x_dot[j] = b.x_dot_drift[j] * normals(word_of(b.key[j], 0.0, 7)).first;
      b.read_x[j] = b.x[j];
      auto state = load_record<State<double>, double, N>(FROM(theta), j);
      for (int i = 0; i < (int)settings.history_states; i++)
        store_record<double, N>(entry(i), j, state);
    }
  }

  // Derives the delays of the sensors; nothing is lost so far.
  INLINE void begin_sampling(int j) {
    b.delay[j] = periods_of(b.latency[j]);
    b.delay_of_theta[j] = periods_of(b.latency[j] + b.theta_latency[j]) - b.delay[j];
    b.delay_of_theta_dot[j] = periods_of(b.latency[j] + b.theta_dot_latency[j]) - b.delay[j];
    b.delay_of_x_dot[j] = periods_of(b.latency[j] + b.x_dot_latency[j]) - b.delay[j];
    b.early[j] = 0.0;
    store_record<double, N>(FROM(lost_theta), j, State<double>{});
  }
  INLINE double periods_of(double latency) const { return rounded(latency / period(), 1.0); }

  INLINE void derive_plant(int j) {
    auto drawn = load_record<Constants<double>, double, N>(FROM(drawn_m), j);
    drawn.motor_friction += b.motor_friction[j];
    auto plant = derive(drawn);
#define FIELD(name) b.plant_##name[j] = plant.name;
    CAPSULE_PLANT(FIELD)
#undef FIELD
    b.normal_force[j] = (b.M[j] + plant.m) * drawn.g * sincos(drawn.slope).cos;
  }

  // The motor's torque in N m for a command, and the push on the platform, from now on.
  INLINE T drive(int j, T command, auto going) {
    auto d = disturbances(j);
    T share = select(going, GET(motor_share), T(0.0));
    T motor = follow_command(d, GET(motor), command, share, T(settings.torque_limit));
    PUT(motor, motor);
    if (any(d.push != 0.0)) PUT(plant_push, pushing_force(d, GET(key), GET(duration)));
    return motor;
  }

  // Takes a reading of every sensor of the environments that take part, where law or agent need it.
  // `begins`: whether episodes begin, whose history `begin` has filled; `last`: whether the agent's
  // step ends.
  NOINLINE void measure(bool begins, bool last) {
    if (!begins) remember_state();
    if (!begins && !last && settings.with_reference == 0.0) return;
    EACH choose_times(j, reads(j));
    look_back();
    double pause = time_between_readings();
    EACH {
      auto active = reads(j);
      T key = GET(key);
      T count = GET(readings);
      auto samples = active & starts_hold(j, count);
      if (acts(GET(lost))) lose_readings(j, active);
      auto [white_0, white_1] = normals(word_of(key, count, 0));
      auto [white_2, slow_2] = normals(word_of(key, count, 1));
      auto [slow_0, slow_1] = normals(word_of(key, count, 2));
      T kept = GET(drift_share);
      T fresh = sqrt(1.0 - kept * kept);
#define SENSOR(name, white, slow)                                                                  \
  {                                                                                                \
    auto d = disturbances(j);                                                                      \
    SensorErrors<T> errors = {d.name##_noise, d.name##_bias, d.name##_drift, d.name##_resolution}; \
    T drift = kept * GET(drift_of_##name) + fresh * slow * errors.drift;                           \
    T reading = read_sensor(errors, GET(late_##name), drift, white);                               \
    if (settings.with_##name == 0.0) reading = 0.0;                                                \
    PUT_WHERE(active, drift_of_##name, drift);                                                     \
    PUT_WHERE(samples, sampled_##name, reading);                                                   \
    PUT_WHERE(active & (GET(lost_##name) == 0.0), read_##name, GET(sampled_##name));               \
  }
      SENSOR(theta, white_0, slow_0)
      SENSOR(theta_dot, white_1, slow_1)
      SENSOR(x_dot, white_2, slow_2)
#undef SENSOR
      T x = GET(read_x) + min(count, T(1.0)) * pause * GET(read_x_dot);
      if (settings.with_x != 0.0) {
        T white = normals(word_of(key, count, 3)).first;
        PUT_WHERE(samples, sampled_x, GET(late_x) + settings.x_noise * white);
        x = select(GET(lost_x) == 0.0, GET(sampled_x), GET(read_x));
      }
      PUT_WHERE(active, read_x, x);
      PUT_WHERE(active, readings, count + 1.0);
    }
  }

  // Whether the environments take part. The law is not called any more where the step has ended
  // early.
  INLINE auto reads(int j) const {
    auto active = GET(active) != 0.0;
    if (settings.with_reference != 0.0) active = active & (GET(halt) != HALTED);
    return active;
  }

  // Draws by how much the next reading is taken before its time.
  INLINE void choose_times(int j, auto active) {
    if (!acts(GET(jitter))) return;
    auto share = uniforms(scramble(word_of(GET(key), GET(readings), 4))).first - 1.0;
    PUT_WHERE(active, early, GET(jitter) * share);
  }

  // Whether the sensors take a new sample: the first one, and after every `hold` repetitions.
  INLINE auto starts_hold(int j, T count) const {
    auto held = GET(hold);
    if (!acts(held)) return count == count;
    T cycle = rounded(held, T(1.0)) + 1.0;
    return count == floor(count / cycle) * cycle;
  }

  // Draws which readings are lost; the first one of an episode is not.
  INLINE void lose_readings(int j, auto active) {
    T key = GET(key);
    T count = GET(readings);
    T probability = select(count > 0.0, GET(lost), T(0.0));
    auto [theta, theta_dot] = uniforms(word_of(key, count, 4));
    auto [x, x_dot] = uniforms(word_of(key, count, 5));
#define LOSE(name) PUT_WHERE(active, lost_##name, select(name - 1.0 < probability, T(1.0), T(0.0)))
    LOSE(theta);
    LOSE(theta_dot);
    LOSE(x);
    LOSE(x_dot);
#undef LOSE
  }

  // Appends the present state to the history.
  INLINE void remember_state() {
    int next = (int)b.cursor[0] + 1;
    b.cursor[0] = next < (int)settings.history_states ? next : 0;
    double* newest = entry((int)b.cursor[0]);
    EACH store_record<T, N>(newest, j, load_record<State<T>, T, N>(FROM(theta), j));
  }

  // Writes the state that the next reading shows: each environment and each sensor has its own
  // latency.
  INLINE void look_back() {
    for (int j = 0; j < n; j++) {
      double apart = b.delay_of_theta[j] + b.delay_of_theta_dot[j] + b.delay_of_x_dot[j];
      if (apart + b.jitter[j] == 0.0) {
        store_record<double, N>(FROM(late_theta), j, state_before(j, (int)b.delay[j]));
        continue;
      }
      double age = b.delay[j] + b.early[j] / period();
      b.late_x[j] = past_state(j, age).x;
      b.late_theta[j] = past_state(j, age + b.delay_of_theta[j]).theta;
      b.late_theta_dot[j] = past_state(j, age + b.delay_of_theta_dot[j]).theta_dot;
      b.late_x_dot[j] = past_state(j, age + b.delay_of_x_dot[j]).x_dot;
    }
  }

  // The state some periods ago.
  INLINE State<double> state_before(int j, int periods) const {
    int place = (int)b.cursor[0] - periods;
    const double* state = entry(place < 0 ? place + (int)settings.history_states : place);
    return load_record<State<double>, double, N>(state, j);
  }
  // The same between two periods, as interpolated.
  INLINE State<double> past_state(int j, double age) const {
    double whole = floor(age);
    State<double> to = state_before(j, (int)whole);
    if (age == whole) return to;
    State<double> from = state_before(j, (int)whole + 1);
    double share = 1.0 - (age - whole);
    auto [theta, theta_dot] = interpolate<double>({from.theta, from.theta_dot},
                                                  {to.theta, to.theta_dot}, share, period());
    auto [x, x_dot] = interpolate<double>({from.x, from.x_dot}, {to.x, to.x_dot}, share, period());
    return {theta, theta_dot, x, x_dot};
  }
};
}  // namespace LEVEL
