// The functions of the plant, elementary ones, and the laws, over arrays: for Python.
#pragma once
#include "contact.hpp"
#include "laws.hpp"
#include "resets.hpp"

namespace LEVEL {
// Name, numbers of arguments and of results, and the call with the arguments a[0], a[1], .. and, for functions of the
// plant, the plant p.
#define CAPSULE_EVALUATED(F)                                                                                           \
  F(accelerations, 5, 3, (p.accelerations(a[0], a[1], a[2], a[3], a[4])))                                              \
  F(normal_force, 3, 1, (p.normal_force(a[0], a[1], a[2])))                                                            \
  F(driving_force, 3, 1, (p.driving_force(a[0], a[1], a[2])))                                                          \
  F(friction_force, 3, 1, (p.friction_force(a[0], a[1], a[2])))                                                        \
  F(stick_margin, 3, 2, (p.stick_margin(a[0], a[1], a[2])))                                                            \
  F(contact_phase, 4, 1, (p.contact_phase(State<double>{a[0], a[1], 0.0, a[2]}, a[3])))                                \
  F(step, 6, 10, (plant_step(State<double>{a[0], a[1], a[2], a[3]}, a[4], p, a[5])))                                   \
  F(sincos, 1, 2, (sincos(a[0]))) F(exp, 1, 1, (exp(a[0]))) F(tanh, 1, 1, (tanh(a[0]))) F(log, 1, 1, (log(a[0])))      \
  F(normals, 1, 2, (normals(scramble(bits_of(a[0])))))                                                                 \
  F(plant_at, 7, 2, (plant_at(a, a[5], a[6]))) F(goal_rate, 2, 1, (Goal::rate(a[0], a[1])))

// The most general plant: one compiled function serves all.
using AnyPlant = Plant<double, Kind::extended>;

// Evaluates function `number` of the list at n places: `in`, shape (arguments, n), after rows of M and mu for functions
// of the plant, the first ones; `out`, shape (results, n).
inline void evaluate(long long number, const double* in, double* out, long long n, const AnyPlant* plant) {
  for (long long i = 0; i < n; i++, in++, out++) {
    AnyPlant p = {};
    double a[7];
    if (plant) p = *plant, p.M = in[0], p.mu = in[n], p.mass_ratio = p.m / (p.M + p.m);
    const double* arguments = plant ? in + 2 * n : in;
    int place = 0;
#define F(name, count, results, call)                                                 \
  if (number == place++) {                                                            \
    for (int k = 0; k < count; k++) a[k] = arguments[k * n];                          \
    auto found = call;                                                                \
    static_assert(sizeof found == results * sizeof(double));                          \
    for (int k = 0; k < results; k++) out[k * n] = ((const double*)&found)[k];        \
  }
    CAPSULE_EVALUATED(F)
#undef F
  }
}

// The torques of n calls of a law of the core, from arrays of shape (n, numbers): the state, the memory, which is
// replaced, and the row of the reference with the task's memory.
inline void law_torques(long long number, const double* constants, const State<double>* states, double* memory,
                        const double* rows, double* torques, long long n) {
  int place = 0;
#define LAW(Law)                                                                                            \
  if (number == place++) {                                                                                  \
    Law law(constants);                                                                                     \
    auto* cells = (Law::Cells<double>*)memory;                                                              \
    auto* lines = (const Law::Line<double>*)rows;                                                           \
    for (long long i = 0; i < n; i++) torques[i] = law.torque(states[i], cells[i], lines[i]);               \
  }
  CAPSULE_LAWS(LAW)
#undef LAW
}

// Moves a platform of total mass M + m for h seconds under a constant force in N, through a stop within this time, and
// returns x'' at the start in m/s^2. `forwards` and `backwards` are the kinetic friction in the two directions, N;
// x_dot is exactly 0.0 in stick.
inline double slide(double force, double forwards, double backwards, double static_ratio, double total, double& x,
                    double& x_dot, double h) {
  double initial = 0.0, remaining = h;
  // At most two parts: the slide until the platform stops, and the motion from rest.
  for (int part = 0; part < 2; part++) {
    bool at_rest = x_dot == 0.0, forward = at_rest ? force > 0.0 : x_dot > 0.0;
    double friction = forward ? forwards : backwards;
    if (at_rest && abs(force) <= static_ratio * friction) break;
    double x_ddot = (forward ? force - friction : force + friction) / total;
    if (part == 0) initial = x_ddot;
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
  return initial;
}

// The motion of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1). The pendulum's
// angle, velocity and acceleration are given at every h seconds, n times. Writes x, x' and x'', shape (3, n), from rest
// at x = 0.
inline void platform_motion(const double* angle, const double* velocity, const double* acceleration, long long n,
                            double h, const AnyPlant& p, double* motion) {
  double x = 0.0, x_dot = 0.0;
  for (long long i = 0; i < n; i++) {
    double force = p.driving_force(angle[i], velocity[i], acceleration[i]);
    double normal = max(0.0, p.normal_force(angle[i], velocity[i], acceleration[i]));
    motion[i] = x, motion[n + i] = x_dot;
    motion[2 * n + i] = slide(force, p.kinetic_friction(1.0) * normal, p.kinetic_friction(-1.0) * normal,
                              p.static_ratio, p.M + p.m, x, x_dot, h);
  }
}
}  // namespace LEVEL
