// The functions of the plant, and elementary ones, over arrays: for Python.
#pragma once
#include "contact.hpp"
#include "layout.hpp"
#include "resets.hpp"

namespace LEVEL {

// Name, numbers of arguments and of results, and the call with the arguments a[0], a[1], .. and the plant p.
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

// Most arguments and results of these.
constexpr int MOST_NUMBERS = 10;

// The most general plant: one compiled function serves all.
using AnyPlant = Plant<double, Kind::extended>;

inline AnyPlant plant_from(const Settings& q, double M, double mu) {
  AnyPlant p;
  p.M = M, p.mu = mu, p.mass_ratio = q.m / (M + q.m), p.pivot_torque_on_contact = q.pivot_torque_on_contact;
#define FIELD(name) p.name = q.name;
  CAPSULE_PLANT(FIELD)
#undef FIELD
  return p;
}

// Evaluates function `number` of the lists at n places: `in`, shape (arguments, n), after rows of M and mu for functions
// of the plant; `out`, shape (results, n).
inline void evaluate_plant(int number, const double* in, double* out, long long n, const Settings& q) {
  for (long long i = 0; i < n; i++) {
    AnyPlant p = plant_from(q, in[i], in[n + i]);
    double a[MOST_NUMBERS], r[MOST_NUMBERS];
    int place = 0, results = 0;
#define F(name, arguments, count, call)                                          \
  if (number == place++) {                                                       \
    for (int k = 0; k < arguments; k++) a[k] = in[(2 + k) * n + i];              \
    auto found = call;                                                           \
    static_assert(sizeof found == count * sizeof(double));                       \
    __builtin_memcpy(r, &found, sizeof found);                                   \
    results = count;                                                             \
  }
    CAPSULE_PLANT_FUNCTIONS(F)
#undef F
    for (int k = 0; k < results; k++) out[k * n + i] = r[k];
  }
}

inline void evaluate(int number, const double* in, double* out, long long n, const Settings* q) {
  if (q) return evaluate_plant(number, in, out, n, *q);
  for (long long i = 0; i < n; i++) {
    double a[MOST_NUMBERS];
    int place = 0;
#define F(name, arguments, count, call)                                                    \
  if (number == place++) {                                                                 \
    for (int k = 0; k < arguments; k++) a[k] = in[k * n + i];                              \
    auto found = call;                                                                     \
    for (int k = 0; k < count; k++) out[k * n + i] = ((const double*)&found)[k];           \
  }
    CAPSULE_ELEMENTARY_FUNCTIONS(F)
#undef F
  }
}

}  // namespace LEVEL
