// The functions of the plant, elementary ones, and the laws, over arrays: for Python.
#pragma once
#include "contact.hpp"
#include "laws.hpp"
#include "resets.hpp"

namespace LEVEL {

// Name, numbers of arguments and of results, and the call with the arguments a[0], a[1], .. and, for functions of the
// plant, the plant p.
#define CAPSULE_PLANT_FUNCTIONS(F)                                                                                     \
  F(accelerations, 5, 3, (accelerations(a[0], a[1], a[2], a[3], a[4], p)))                                             \
  F(normal_force, 3, 1, (normal_force(a[0], a[1], a[2], p)))                                                           \
  F(driving_force, 3, 1, (driving_force(a[0], a[1], a[2], p)))                                                         \
  F(friction_force, 3, 1, (friction_force(a[0], a[1], a[2], p)))                                                       \
  F(stick_acceleration, 3, 1, (stick_acceleration(a[0], a[1], a[2], p)))                                               \
  F(stick_margin, 3, 2, (stick_margin(a[0], a[1], a[2], p)))                                                           \
  F(stick_margin_rate, 3, 1, (stick_margin_rate(a[0], a[1], a[2], p)))                                                 \
  F(contact_phase, 4, 1, (contact_phase(State<double>{a[0], a[1], 0.0, a[2]}, a[3], p)))                               \
  F(step, 6, 10, (plant_step(State<double>{a[0], a[1], a[2], a[3]}, a[4], p, a[5])))
#define CAPSULE_ELEMENTARY_FUNCTIONS(F)                                                                                \
  F(sincos, 1, 2, (sincos(a[0]))) F(exp, 1, 1, (exp(a[0]))) F(tanh, 1, 1, (tanh(a[0]))) F(log, 1, 1, (log(a[0])))      \
  F(normals, 1, 2, (normals(scramble(bits_of(a[0])))))                                                                 \
  F(plant_at, 7, 2, (plant_at(a, a[5], a[6])))

// The most general plant: one compiled function serves all.
using AnyPlant = Plant<double, Kind::extended>;

// Evaluates function `number` of both lists at n places: `in`, shape (arguments, n), after rows of M and mu for functions
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
    CAPSULE_PLANT_FUNCTIONS(F) CAPSULE_ELEMENTARY_FUNCTIONS(F)
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
    for (long long i = 0; i < n; i++)                                                                       \
      torques[i] = law(states[i], memory + Law::MEMORY * i, rows + Law::COLUMNS * i);                       \
  }
  CAPSULE_LAWS(LAW)
#undef LAW
}

}  // namespace LEVEL
