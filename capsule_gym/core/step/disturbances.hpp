// The disturbances of sensors, motor and platform, and what each does to a reading or a torque;
// `capsule_gym.Disturbances` documents them. Random numbers are hashes of the episode's key and a
// counter, so that a reading is the same alone and in a batch.
#pragma once
#include "../numbers/random.hpp"

// How readings are taken and passed on; their draws have a stream of their own.
#define CAPSULE_SAMPLING(FIELD) \
  FIELD(jitter)                 \
  FIELD(lost)                   \
  FIELD(hold)                   \
  FIELD(theta_latency)          \
  FIELD(theta_dot_latency)      \
  FIELD(x_dot_latency)

// What an episode draws; SI units.
#define CAPSULE_DISTURBANCES(FIELD) \
  FIELD(theta_noise)                \
  FIELD(theta_dot_noise)            \
  FIELD(x_dot_noise)                \
  FIELD(theta_bias)                 \
  FIELD(theta_dot_bias)             \
  FIELD(x_dot_bias)                 \
  FIELD(theta_drift)                \
  FIELD(theta_dot_drift)            \
  FIELD(x_dot_drift)                \
  FIELD(drift_time)                 \
  FIELD(theta_resolution)           \
  FIELD(theta_dot_resolution)       \
  FIELD(x_dot_resolution)           \
  FIELD(latency)                    \
  FIELD(lag)                        \
  FIELD(motor_friction)             \
  FIELD(torque_resolution)          \
  FIELD(push)                       \
  CAPSULE_SAMPLING(FIELD)

namespace LEVEL {
template <class T> struct Sampling {
  CAPSULE_SAMPLING(CAPSULE_NUMBER)
};
template <class T> struct Disturbances {
  CAPSULE_DISTURBANCES(CAPSULE_NUMBER)
};

// Added to a whole number: the lowest 52 bits of the sum are those of the number.
constexpr double WHOLE_BITS = 4503599627370496.0;
// Duration of the push in every second, s.
constexpr double PUSH_TIME = 0.1;
// Tolerance of the episode's time, s.
constexpr double ROUNDING_OF_TIME = 1e-9;

// One of the eight random words of a reading.
template <class T> INLINE auto word_of(T key, T count, Word place) {
  // The odd number nearest to 2^64 over the golden ratio.
  constexpr Word GOLDEN = 0x9E3779B97F4A7C15;
  return scramble(bits_of(key) + GOLDEN * (bits_of(count + WHOLE_BITS) * 8ULL + place));
}

// The multiple of the resolution that is nearest to the value, or the value where the resolution is
// 0.
template <class T> INLINE T rounded(T value, T resolution) {
  auto rounds = resolution > 0.0;
  T unit = select(rounds, resolution, T(1.0));
  return select(rounds, ((value / unit + ROUNDING) - ROUNDING) * unit, value);
}

// The errors of one sensor: the size of its white noise, its bias, the size of its drift, and its
// resolution.
template <class T> struct SensorErrors {
  T noise, bias, drift, resolution;
};

// The reading of a sensor that shows a value, with the present drift and a standard normal number.
template <class T> INLINE T read_sensor(const SensorErrors<T>& errors, T shown, T drift, T white) {
  T error = errors.bias + drift + white * errors.noise;
  return rounded(shown + error, errors.resolution);
}

// A coordinate and its rate at a share of the way between two times, `h` seconds apart.
template <class T> struct Coordinate {
  T value, rate;
};

// By the cubic polynomial with the coordinates and the rates at both times.
template <class T>
INLINE Coordinate<T> interpolate(Coordinate<T> from, Coordinate<T> to, T share, double h) {
  T change = to.value - from.value;
  T linear = h * from.rate;
  T square = 3.0 * change - h * (2.0 * from.rate + to.rate);
  T cube = h * (from.rate + to.rate) - 2.0 * change;
  T value = from.value + share * (linear + share * (square + share * cube));
  return {value, (linear + share * (2.0 * square + share * (3.0 * cube))) / h};
}

// The motor's torque after one period, in which it covers the fraction `share` of its distance to
// the rounded command. Neither rounding takes it beyond its limit.
template <class T>
INLINE T follow_command(const Disturbances<T>& d, T motor, T command, T share, T limit) {
  T rounded_command = clip(rounded(command, d.torque_resolution), limit);
  return clip(motor + share * (rounded_command - motor), limit);
}

// The force on the platform at this time of the episode: in every second one of random size, at a
// random time.
template <class T> INLINE T pushing_force(const Disturbances<T>& d, T key, T duration) {
  constexpr Word FACTOR = 0x5851F42D4C957F2D;
  T time = duration + ROUNDING_OF_TIME;
  T second = floor(time);
  auto [begins, size] = uniforms(scramble(bits_of(key) + FACTOR * bits_of(second + WHOLE_BITS)));
  T since = time - second - (1.0 - PUSH_TIME) * (begins - 1.0);
  auto pushes = (since >= 0.0) & (since < PUSH_TIME);
  return select(pushes, d.push * (2.0 * size - 3.0), T(0.0));
}
}  // namespace LEVEL
