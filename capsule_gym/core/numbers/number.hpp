// Numbers of one environment (double, bool) and of several (Pack, Mask) under the same operators
// and functions, so that the physics is written once, as templates over the number type. Conditions
// are masks, joined with & and |; `select` chooses by them. A new number type, such as a dual
// number, supplies what Pack supplies here.
#pragma once

// Equal bits on every machine need every operation rounded as it is written.
#if defined(__FAST_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__) || \
    defined(__ASSOCIATIVE_MATH__) || __FINITE_MATH_ONLY__ || __FLT_EVAL_METHOD__ ||           \
    (defined(__GCC_IEC_559) && !__GCC_IEC_559) || __DBL_MANT_DIG__ != 53 ||                   \
    !defined(CAPSULE_FP_CONTRACT_OFF)
#error "every operation must be rounded as it is written: compile as CMakeLists.txt does"
#endif

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#if defined(CAPSULE_INSTRUMENTED) || (defined(__x86_64__) && !defined(__FMA__))
// Checks of addresses, or on processors before 2013 calls of the library's fma, take most of the
// time: inlined everywhere, they would take most of the compiler's.
#define INLINE inline
#else
#define INLINE inline __attribute__((always_inline))
#endif
// For what is rare: inlined, it would take registers from the loops over environments.
#define NOINLINE __attribute__((noinline))

// Each level of instructions is a namespace, so that the linker cannot mix their functions.
#ifndef LEVEL
#define LEVEL portable
#endif

// For lists of names: the fields of a struct, and their names in a text.
#define CAPSULE_DOUBLE(name) double name;
#define CAPSULE_NUMBER(name) T name;
#define CAPSULE_NAME(name) #name " "

namespace LEVEL {
constexpr double INFINITE = __builtin_inf();
constexpr double PI = 3.141592653589793;

typedef unsigned long long Word;

// --- one environment ---

#if defined(__wasm__)
// WebAssembly has no fused instruction. Exported policies in C contain the same file, in which NAME
// is their own.
#include "fused.h"
INLINE double fma(double a, double b, double c) { return NAME_fused(a, b, c); }
#else
INLINE double fma(double a, double b, double c) { return __builtin_fma(a, b, c); }
#endif
INLINE double abs(double x) { return __builtin_fabs(x); }
INLINE double sqrt(double x) { return __builtin_sqrt(x); }
INLINE double floor(double x) { return __builtin_floor(x); }
INLINE double copysign(double size, double sign) { return __builtin_copysign(size, sign); }
INLINE double select(bool condition, double a, double b) { return condition ? a : b; }
// For branches of one environment, `if (auto taken = when(condition))`, which other number types
// may execute otherwise.
INLINE bool when(bool condition) { return condition; }
INLINE Word bits_of(double x) { return __builtin_bit_cast(Word, x); }
INLINE double from_bits(Word word) { return __builtin_bit_cast(double, word); }
// One bit per environment.
INLINE unsigned lanes(bool condition) { return condition; }

// --- as many environments as a register holds ---

#if defined(__AVX512F__)
constexpr int PACK = 8;
#elif defined(__FMA__)
constexpr int PACK = 4;
#else
constexpr int PACK = 2;
#endif
typedef double Doubles __attribute__((vector_size(8 * PACK)));
typedef long long Integers __attribute__((vector_size(8 * PACK)));
typedef Word Words __attribute__((vector_size(8 * PACK)));

struct Mask {
  Integers m;
  friend INLINE Mask operator&(Mask a, Mask b) { return {a.m & b.m}; }
  friend INLINE Mask operator|(Mask a, Mask b) { return {a.m | b.m}; }
  friend INLINE Mask operator!(Mask a) { return {~a.m}; }
};

struct Pack {
  Doubles v;
  Pack() = default;
  INLINE Pack(Doubles v) : v(v) {}
  // The difference is x in all lanes, also for -0.0 and NaN.
  INLINE Pack(double x) : v(x - Doubles{}) {}
#define OPERATOR(Result, symbol) \
  friend INLINE Result operator symbol(Pack a, Pack b) { return {a.v symbol b.v}; }
  OPERATOR(Pack, +)
  OPERATOR(Pack, -)
  OPERATOR(Pack, *)
  OPERATOR(Pack, /)
  OPERATOR(Mask, ==)
  OPERATOR(Mask, !=)
  OPERATOR(Mask, <)
  OPERATOR(Mask, >)
  OPERATOR(Mask, <=)
  OPERATOR(Mask, >=)
#undef OPERATOR
  friend INLINE Pack operator-(Pack a) { return -a.v; }
};

INLINE Pack select(Mask condition, Pack a, Pack b) { return condition.m ? a.v : b.v; }
INLINE Pack abs(Pack a) { return (Doubles)((Integers)a.v & 0x7fffffffffffffffLL); }
INLINE Words bits_of(Pack x) { return (Words)x.v; }
INLINE Pack from_bits(Words words) { return (Doubles)words; }
INLINE Pack copysign(Pack size, Pack sign) {
  constexpr Word SIGN = 1ULL << 63;
  return from_bits((bits_of(size) & ~SIGN) | (bits_of(sign) & SIGN));
}

#if defined(__AVX512F__)
INLINE Pack fma(Pack a, Pack b, Pack c) {
  return (Doubles)_mm512_fmadd_pd((__m512d)a.v, (__m512d)b.v, (__m512d)c.v);
}
INLINE Pack sqrt(Pack x) { return (Doubles)_mm512_maskz_sqrt_pd(0xff, (__m512d)x.v); }
INLINE Pack floor(Pack x) {
  return (Doubles)_mm512_maskz_roundscale_pd(0xff, (__m512d)x.v, _MM_FROUND_TO_NEG_INF);
}
INLINE unsigned lanes(Mask condition) { return _mm512_movepi64_mask((__m512i)condition.m); }
#elif defined(__FMA__)
INLINE Pack fma(Pack a, Pack b, Pack c) {
  return (Doubles)_mm256_fmadd_pd((__m256d)a.v, (__m256d)b.v, (__m256d)c.v);
}
INLINE Pack sqrt(Pack x) { return (Doubles)_mm256_sqrt_pd((__m256d)x.v); }
INLINE Pack floor(Pack x) { return (Doubles)_mm256_floor_pd((__m256d)x.v); }
INLINE unsigned lanes(Mask condition) { return (unsigned)_mm256_movemask_pd((__m256d)condition.m); }
#else
#if __has_builtin(__builtin_elementwise_fma)
INLINE Pack fma(Pack a, Pack b, Pack c) { return __builtin_elementwise_fma(a.v, b.v, c.v); }
#elif defined(__aarch64__)
INLINE Pack fma(Pack a, Pack b, Pack c) {
  return (Doubles)vfmaq_f64((float64x2_t)c.v, (float64x2_t)a.v, (float64x2_t)b.v);
}
#else
INLINE Pack fma(Pack a, Pack b, Pack c) {
  return Doubles{fma(a.v[0], b.v[0], c.v[0]), fma(a.v[1], b.v[1], c.v[1])};
}
#endif
INLINE Pack sqrt(Pack x) { return Doubles{sqrt(x.v[0]), sqrt(x.v[1])}; }
INLINE Pack floor(Pack x) { return Doubles{floor(x.v[0]), floor(x.v[1])}; }
INLINE unsigned lanes(Mask condition) { return (condition.m[0] != 0) | (condition.m[1] != 0) << 1; }
#endif

// The numbers at these places.
INLINE Pack gather(const double* at, const int (&i)[PACK]) {
  Doubles values = {};
  for (int k = 0; k < PACK; k++) values[k] = at[i[k]];
  return values;
}

// --- both ---

template <class T> constexpr int WIDTH = sizeof(T) / sizeof(double);
template <class T> INLINE T load(const double* at) {
  T values;
  __builtin_memcpy(&values, at, sizeof values);
  return values;
}
template <class T> INLINE void store(double* at, T values);
template <> INLINE void store(double* at, double value) { *at = value; }
// Not by a copy of bytes, which the compiler would take for a write to anything, also to pointers.
typedef double Unaligned __attribute__((vector_size(8 * PACK), aligned(8)));
template <> INLINE void store(double* at, Pack values) { *(Unaligned*)at = values.v; }
// A struct of numbers from consecutive rows of N lanes, of each of which `read` gives the numbers.
template <class Record, int N> INLINE Record read_record(const double* rows, auto read) {
  using T = decltype(read(rows));
  Record record;
  for (int r = 0; r < (int)(sizeof record / sizeof(T)); r++) ((T*)&record)[r] = read(rows + r * N);
  return record;
}
// The numbers T at the lanes from j on.
template <class Record, class T, int N> INLINE Record load_record(const double* rows, int j) {
  return read_record<Record, N>(rows, [j](const double* row) { return load<T>(row + j); });
}
template <class T, int N, class Record>
INLINE void store_record(double* rows, int j, const Record& record) {
  for (int r = 0; r < (int)(sizeof record / sizeof(T)); r++)
    store<T>(rows + r * N + j, ((const T*)&record)[r]);
}
// Only in the lanes where `renews`; the others keep theirs.
template <class T, int N, class Record>
INLINE void store_record(double* rows, int j, const Record& record, auto renews) {
  for (int r = 0; r < (int)(sizeof record / sizeof(T)); r++) {
    double* at = rows + r * N + j;
    store<T>(at, select(renews, ((const T*)&record)[r], load<T>(at)));
  }
}
INLINE bool any(auto condition) { return lanes(condition) != 0; }
// Whether terms with this factor count: it is not zero in every lane.
INLINE bool acts(auto factor) { return any(factor != 0.0); }

// `min` and `max` of a NaN and of zeros of both signs give the first argument, as Python's.
template <class T> INLINE T min(T a, T b) { return select(b < a, b, a); }
template <class T> INLINE T max(T a, T b) { return select(b > a, b, a); }
// The value within -limit to limit; NaN stays NaN.
template <class T> INLINE T clip(T value, T limit) {
  return select(value > limit, limit, select(value < -limit, -limit, value));
}
// a b + c, rounded once if `fused`, else twice.
template <bool fused, class T> INLINE T multiply_add(const T& a, const T& b, const T& c) {
  if constexpr (fused) return fma(a, b, c);
  else return a * b + c;
}
template <class T> INLINE T sign_of(T x) {
  return select(x > 0.0, T(1.0), select(x < 0.0, T(-1.0), T(0.0)));
}

// Types, each of which has its place as its number.
template <class... Types> struct List {};
// Calls f<Type>() for the type with a number; returns whether there is one.
template <class... Types> INLINE bool with_type(List<Types...>, long long number, auto f) {
  long long place = 0;
  bool found = false;
  auto call_at = [&]<class Type>() {
    if (number != place++) return;
    f.template operator()<Type>();
    found = true;
  };
  (call_at.template operator()<Types>(), ...);
  return found;
}
}  // namespace LEVEL
