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
// lacks what `__builtin_cpu_supports` reads, and says no to everything. `static`, so that the
// linker cannot take a copy from level.cpp, which is compiled for instructions that the processor
// may lack.
static inline int best_level() {
  constexpr int V4 = 0, V3 = 1, PORTABLE = 2;
  // Bits of leaf 1, register c, and of leaf 7, register b.
  constexpr unsigned FMA = 1u << 12, XGETBV = 1u << 27;
  constexpr unsigned BMI1 = 1u << 3, AVX2 = 1u << 5, BMI2 = 1u << 8;
  constexpr unsigned AVX512F = 1u << 16, AVX512DQ = 1u << 17, AVX512CD = 1u << 28;
  constexpr unsigned AVX512BW = 1u << 30, AVX512VL = 1u << 31;
  // What the operating system saves: registers of 128 and 256 bits; those of 512 bits and masks.
  constexpr unsigned YMM = 0x06, ZMM = 0xe6;
  auto all = [](unsigned present, unsigned needed) { return (present & needed) == needed; };
  unsigned a, b, c, d, saved, high;
  if (__get_cpuid_max(0, nullptr) < 7) return PORTABLE;
  __cpuid(1, a, b, c, d);
  if (!all(c, FMA | XGETBV)) return PORTABLE;
  __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
  __cpuid_count(7, 0, a, b, c, d);
  if (!all(saved, YMM) || !all(b, BMI1 | AVX2 | BMI2)) return PORTABLE;
  bool v4 = all(saved, ZMM) && all(b, AVX512F | AVX512DQ | AVX512CD | AVX512BW | AVX512VL);
  return v4 ? V4 : V3;
}
#else
constexpr Level LEVELS[] = {{"portable", portable::find}};
static inline int best_level() { return 0; }
#endif
