// Functions over arrays and over whole episodes: for Python.
#pragma once
#include "../network.hpp"
#include "../step/resets.hpp"
#include "../step/contract.hpp"
#include "../step/step.hpp"
#include "instruction_levels.hpp"

namespace LEVEL {
// The most general plant: one compiled function serves all.
using AnyPlant = Plant<double, Kind::extended>;
constexpr int MOST_RESULTS = WIDTH<AnyPlant>;  // of a function that `evaluate` knows

// How a parameter of a function that is evaluated is given: by numbers of a row, or as the plant.
template <class T> struct Given {
  static constexpr int NUMBERS = WIDTH<T>;
  static constexpr bool PLANT = false;
  static T read(const double*& row, const AnyPlant&) {
    T value = load<T>(row);
    row += NUMBERS;
    return value;
  }
};
template <class T> struct Given<const T&> : Given<T> {};
template <> struct Given<const AnyPlant&> {
  static constexpr int NUMBERS = 0;
  static constexpr bool PLANT = true;
  static const AnyPlant& read(const double*&, const AnyPlant& p) { return p; }
};
template <class... Parameters> constexpr bool OF_PLANT = (Given<Parameters>::PLANT || ...);
// Of a row, which begins with M and mu where there is a plant.
template <class... Parameters>
constexpr int NUMBERS = (Given<Parameters>::NUMBERS + ...) + (OF_PLANT<Parameters...> ? 2 : 0);

// Evaluates a function at n places: `in` has the shape (n, numbers), `out` (results, n). Returns
// the number of results. module.cpp has checked `numbers`, and whether there is a plant.
template <auto function, class Result, class... Parameters>
long long evaluate(const double* in, long long numbers, double* out, long long n,
                   const AnyPlant* plant) {
  struct Call {
    Result result;
    explicit Call(Parameters... given) : result(function(given...)) {}
  };
  for (long long i = 0; i < n; i++) {
    const double* row = in + i * numbers;
    AnyPlant p = {};
    if constexpr (OF_PLANT<Parameters...>) {
      p = *plant;
      p.M = *row++;
      p.mu = *row++;
      p.mass_ratio = p.m / (p.M + p.m);
    }
    // Braces read the numbers in their order.
    Result found = Call{Given<Parameters>::read(row, p)...}.result;
    for (int k = 0; k < WIDTH<Result>; k++) out[k * n + i] = ((const double*)&found)[k];
  }
  return WIDTH<Result>;
}

template <auto function, class Result, class... Parameters>
constexpr Function evaluated(const char* name, Result (*)(Parameters...)) {
  static_assert(WIDTH<Result> <= MOST_RESULTS);
  Function found = named<evaluate<function, Result, Parameters...>>(name);
  found.numbers = NUMBERS<Parameters...>;
  found.of_plant = OF_PLANT<Parameters...>;
  return found;
}
template <auto method, class Result, class... Parameters>
Result call_method(const AnyPlant& p, Parameters... given) {
  return (p.*method)(given...);
}
template <auto method, class Result, class... Parameters>
constexpr Function evaluated(const char* name, Result (AnyPlant::*)(Parameters...) const) {
  constexpr auto function = call_method<method, Result, Parameters...>;
  return evaluated<function>(name, function);
}
// A function, or a method of the plant, that `evaluate` evaluates, by the name that Python uses.
template <auto function> constexpr Function evaluated(const char* name) {
  return evaluated<function>(name, function);
}

// Two normal numbers from the bits of a number.
inline Two<double> normals_from(double number) { return normals(scramble(bits_of(number))); }

// The torques of n calls of a law of the core, from arrays of shape (n, numbers): the state, the
// memory, which is replaced, and the row of the reference with the task's memory. A call with a
// state that is not finite gives 0.0 and keeps the memory.
inline void law_torques(long long number, const double* constants, const State<double>* states,
                        double* memory, const double* rows, double* torques, long long n) {
  with_type(Laws(), number, [=]<class Law>() {
    Law law(constants);
    auto* cells = (typename Law::template Cells<double>*)memory;
    auto* lines = (const typename Law::template Line<double>*)rows;
    for (long long i = 0; i < n; i++) {
      auto [theta, theta_dot, x, x_dot] = states[i];
      bool finite = abs(theta) + abs(theta_dot) + abs(x) + abs(x_dot) < INFINITE;
      torques[i] = finite ? law.torque(states[i], cells[i], lines[i]) : 0.0;
    }
  });
}

// The motion of the platform while the pendulum follows a prescribed motion: the second row of Eq.
// (1). The pendulum's angle, velocity and acceleration are given at every h seconds, n times.
// Writes x, x' and x'', shape (3, n), from rest at x = 0; x' is exactly 0.0 in stick.
//
// The step is not used, only its functions for the forces: with theta'' given, nothing is left to
// solve. The forces are constant over an interval; viscous friction and the Stribeck curve, which
// depend on x', are left out.
inline void platform_motion(const double* angle, const double* velocity, const double* acceleration,
                            long long n, double h, const AnyPlant& plant, double* motion) {
  AnyPlant p = plant;
  p.stribeck_excess = 0.0;  // without the Stribeck curve
  double* positions = motion;
  double* velocities = motion + n;
  double* accelerations = motion + 2 * n;
  double x = 0.0, x_dot = 0.0;
  for (long long i = 0; i < n; i++) {
    double force = p.driving_force(angle[i], velocity[i], acceleration[i]);
    double normal = max(0.0, p.normal_force(angle[i], velocity[i], acceleration[i]));
    positions[i] = x;
    velocities[i] = x_dot;
    accelerations[i] = 0.0;
    double remaining = h;
    // At most two parts: the slide until the platform stops, and the motion from rest.
    for (int part = 0; part < 2; part++) {
      if (x_dot == 0.0 && abs(force) <= p.static_friction_limit(force, normal)) break;
      double direction = x_dot == 0.0 ? force : x_dot;
      double slip = direction > 0.0 ? 1.0 : -1.0;
      double x_ddot = (force - p.friction_force(slip, x_dot, normal)) / (p.M + p.m);
      if (part == 0) accelerations[i] = x_ddot;
      double after = x_dot + remaining * x_ddot;
      if (x_dot * after >= 0.0) {
        x = x + remaining * (x_dot + 0.5 * remaining * x_ddot);
        x_dot = after;
        break;
      }
      x = x - 0.5 * x_dot * x_dot / x_ddot;
      remaining = remaining + x_dot / x_ddot;
      x_dot = 0.0;
    }
  }
}

// Steps the environments first..last-1 of `batch` with a trained policy, each until its episode
// ends, without Python between the steps, and returns as `advance`.
template <int N>
long long run_episodes(const Batch& batch, long long first, long long last, long long steps,
                       const double* network, double* memory) {
  const int size = memory_size(*(const Header*)network);
  for (long long at = first; at < last; at += N) {
    auto& block = block_of<N>(batch, at);
    int n = last - at < N ? (int)(last - at) : N;
    int going = n;
    // One more step than needed, so that the final state is that of a loop in Python.
    for (long long step = 0; step < steps && going > 0; step++) {
      going = 0;
      for (int j = 0; j < n; j++) {
        bool active = block.termination[j] == 0.0;
        block.active[j] = active;
        going += active;
      }
      float actions[N];
      act(network, batch.observations + at * batch.layout->entries, memory + at * size, n, actions);
      for (int j = 0; j < n; j++) block.action[j] = actions[j];
      long long broken = advance(batch, at, at + n, false);
      if (broken >= 0) return broken;
    }
  }
  return -1;
}
}  // namespace LEVEL
