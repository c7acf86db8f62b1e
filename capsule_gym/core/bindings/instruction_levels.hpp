// The levels of instructions: those that the module contains, and the best one that the processor runs.
//
// level.cpp is compiled once for each, into a namespace with the level's name. module.cpp calls the functions of a
// level by their names.
#pragma once
#if defined(__x86_64__)
#include <cpuid.h>
#endif

// An argument of a function of level.cpp: a whole or real number, or an address.
struct Argument {
  long long bits;
  operator long long() const { return bits; }
  operator double() const { return __builtin_bit_cast(double, bits); }
  template <class T> operator T*() const { return (T*)bits; }
};
constexpr int MOST_ARGUMENTS = 7;
// Calls a function by its name. Returns the index of an environment whose law has failed, -1, or UNKNOWN.
typedef long long Call(const char* function, const Argument* arguments);
constexpr long long UNKNOWN = -2;  // there is no function of this name

namespace portable { Call call; }
namespace v3 { Call call; }
namespace v4 { Call call; }

struct Level {
  const char* name;
  Call* call;
};
// The best first.
#if defined(__x86_64__)
constexpr Level LEVELS[] = {{"v4", v4::call}, {"v3", v3::call}, {"portable", portable::call}};

// The place of the best level that the processor runs. The processor itself answers: zig's runtime lacks what
// `__builtin_cpu_supports` reads, and says no to everything. `static`, so that the linker cannot take a copy from
// level.cpp, which is compiled for instructions that the processor may lack.
static inline int best_level() {
  unsigned a, b, c, d, enabled, high;
  if (__get_cpuid_max(0, nullptr) < 7) return 2;
  __cpuid(1, a, b, c, d);
  bool fma = c >> 12 & 1, xgetbv = c >> 27 & 1;
  if (!fma || !xgetbv) return 2;
  __asm__("xgetbv" : "=a"(enabled), "=d"(high) : "c"(0));
  __cpuid_count(7, 0, a, b, c, d);
  const unsigned V3 = 1u << 3 | 1u << 5 | 1u << 8, V4 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
  if ((enabled & 6) != 6 || (b & V3) != V3) return 2;
  return (enabled & 0xe6) == 0xe6 && (b & V4) == V4 ? 0 : 1;
}
#else
constexpr Level LEVELS[] = {{"portable", portable::call}};
static inline int best_level() { return 0; }
#endif
