/* Exported policies on any readings, with a law and with a recurrent cell: torques stay within the
   limit, and the memory holds no NaN. */
#include "law.h"
#include "recurrent.h"

#define CHECK(condition) \
  if (!(condition)) __builtin_trap()

/* Any double, or one of a moderate size. */
static double number(const uint8_t* data) {
  double any;
  int16_t moderate;
  memcpy(&any, data + 1, sizeof any);
  memcpy(&moderate, data + 1, sizeof moderate);
  return *data & 1 ? any : moderate / 1000.0;
}

/* PERIODS: calls of the law in an agent step. */
#define EPISODE(name, PERIODS, LAW, ACT)                                               \
  static void run_##name(const uint8_t* data, size_t size) {                           \
    enum { READINGS = sizeof(name##_reading) / sizeof(double), BYTES = 9 * READINGS }; \
    name##_memory memory;                                                              \
    float observation[name##_ENTRIES];                                                 \
    int period;                                                                        \
    for (period = 0; size >= BYTES; period++, data += BYTES, size -= BYTES) {          \
      const double* cells = (const double*)&memory;                                    \
      double readings[READINGS], torque;                                               \
      name##_reading reading;                                                          \
      size_t i;                                                                        \
      for (i = 0; i < READINGS; i++) readings[i] = number(data + 9 * i);               \
      memcpy(&reading, readings, sizeof reading);                                      \
      if (period == 0) name##_start(&memory, &reading);                                \
      LAW;                                                                             \
      if (period % PERIODS == 0) {                                                     \
        name##_observe(&memory, &reading, observation);                                \
        reading.action = ACT;                                                          \
        CHECK(reading.action >= -1.0 && reading.action <= 1.0);                        \
      }                                                                                \
      torque = name##_torque(&reading, reading.action);                                \
      CHECK(torque >= -name##_TORQUE_LIMIT && torque <= name##_TORQUE_LIMIT);          \
      for (i = 0; i < offsetof(name##_memory, begun) / sizeof(double); i++)            \
        CHECK(!isnan(cells[i]));                                                       \
    }                                                                                  \
  }

EPISODE(residual_real, 20, residual_real_law(&memory, &reading), residual_real_act(observation))
EPISODE(direct_recurrent_ppo, 1, , direct_recurrent_ppo_act(&memory, observation))

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  if (*data & 1)
    run_residual_real(data + 1, size - 1);
  else
    run_direct_recurrent_ppo(data + 1, size - 1);
  return 0;
}
