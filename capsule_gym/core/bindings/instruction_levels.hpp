// The levels of instructions: those that the module contains, and the best one that the processor
// runs.
//
// level.cpp is compiled once for each, into a namespace with the level's name. module.cpp calls the
// functions of a level by their names.
#pragma once
#if defined(__x86_64__)
#include <cpuid.h>
#endif
#include "signatures.hpp"

// The function of a level with this name, or null.
typedef const Function* Find(const char* name);
namespace portable {
Find find;
}
namespace v3 {
Find find;
}
namespace v4 {
Find find;
}

struct Level {
  const char* name;
  Find* find;
};
// The best first.
#if defined(__x86_64__)
constexpr Level LEVELS[] = {{"v4", v4::find}, {"v3", v3::find}, {"portable", portable::find}};

// The place of the best level that the processor runs. The processor itself answers: zig's runtime
// lacks what
// `__builtin_cpu_supports` reads, and says no to everything. `static`, so that the linker cannot
// take a copy from level.cpp, which is compiled for instructions that the processor may lack.
static inline int best_level() {
  unsigned a, b, c, d, enabled, high;
  if (__get_cpuid_max(0, nullptr) < 7) return 2;
  __cpuid(1, a, b, c, d);
  bool fma = c >> 12 & 1, xgetbv = c >> 27 & 1;
  if (!fma || !xgetbv) return 2;
  __asm__("xgetbv" : "=a"(enabled), "=d"(high) : "c"(0));
  __cpuid_count(7, 0, a, b, c, d);
  const unsigned V3 = 1u << 3 | 1u << 5 | 1u << 8,
                 V4 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
  if ((enabled & 6) != 6 || (b & V3) != V3) return 2;
  return (enabled & 0xe6) == 0xe6 && (b & V4) == V4 ? 0 : 1;
}
#else
constexpr Level LEVELS[] = {{"portable", portable::find}};
static inline int best_level() { return 0; }
#endif
