// The entry points of the core at one level of instructions.
#pragma once
#include "layout.hpp"

constexpr long long NO_MEMORY = -2;

struct Level {
  const char* name;
  long long (*advance)(const Batch&, long long first, long long last, bool begin);
  void (*draw_episodes)(const Batch&, long long count);
  void (*begin_episodes)(const Batch&, long long count);
  void (*evaluate)(int function, const double* in, double* out, long long n, const Settings*);
  // Torques of a law of the core, from arrays of shape (n, numbers): the state, the memory, which is replaced, and the row
  // of the reference with the task's memory.
  void (*law_torques)(long long law, const double* constants, const double* states, double* memory, const double* rows,
                      double* torques, long long n);
  // See laws/reference.hpp; `plant` holds M, mu, m / (M + m), the constants of `CAPSULE_PLANT` and
  // pivot_torque_on_contact.
  void (*platform_motion)(const double* angle, const double* velocity, const double* acceleration, const double* plant,
                          double* motion, long long n, double h);
  // The functions of network.hpp; `act_batch` allocates its working memory and returns whether there was enough.
  bool (*act_batch)(const double* network, const float* observations, long long entries, long long n, double* memory,
                    float* actions);
  void (*write_inputs)(const double* header, const float* observations, long long entries, long long n, double* memory,
                       float* inputs);
  // Episodes of a policy; see rollout.hpp. NO_MEMORY where there was not enough.
  long long (*run_episodes)(const Batch&, long long first, long long last, long long steps, double control_dt,
                            const double* network, double* memory, const double* changes, long long num_changes);
};
