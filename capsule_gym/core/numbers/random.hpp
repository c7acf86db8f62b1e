// Random numbers: those of an episode's start, and the noise of an episode.
#pragma once
#include "elementary.hpp"

namespace LEVEL {
// The upper 64 bits of a product of two words.
inline Word high_word(Word a, Word b) { return (Word)((unsigned __int128)a * b >> 64); }

// Number `place` of those in [0, 1) that NumPy's Philox generator gives for this key and the
// counter [0, stream, episode, 0]: Philox4x64-10 (Salmon et al., "Parallel random numbers: as easy
// as 1, 2, 3", 2011).
inline double draw(const Word* key, Word stream, Word episode, int place) {
  constexpr Word FACTOR_0 = 0xD2E7470EE14C6C93;
  constexpr Word FACTOR_1 = 0xCA5A826395121157;
  constexpr double UNIT = 1.0 / 9007199254740992.0;  // of the upper 53 bits
  Word words[4] = {1 + (Word)place / 4, stream, episode, 0};
  Word key_0 = key[0];
  Word key_1 = key[1];
  for (int round = 0; round < 10; round++) {
    auto [a, b, c, d] = words;
    words[0] = high_word(FACTOR_1, c) ^ b ^ key_0;
    words[1] = FACTOR_1 * c;
    words[2] = high_word(FACTOR_0, a) ^ d ^ key_1;
    words[3] = FACTOR_0 * a;
    key_0 += 0x9E3779B97F4A7C15;
    key_1 += 0xBB67AE8584CAA73B;
  }
  return UNIT * (double)(words[place % 4] >> 11);
}

// A word of which every bit depends on every bit of the given one: SplitMix64's mixing function
// (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
template <class W> INLINE W scramble(W word) {
  word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9ULL;
  word = (word ^ (word >> 27)) * 0x94D049BB133111EBULL;
  return word ^ (word >> 31);
}

template <class T> struct Two {
  T first, second;
};

constexpr Word ONE_BITS = 1023ULL << 52;
constexpr Word FRACTION = (1ULL << 52) - 1;

// Two numbers in [1, 2), multiples of 2^-32, from the halves of a random word.
template <class W> INLINE auto uniforms(W word) {
  auto first = from_bits((word >> 32) << 20 | ONE_BITS);
  auto second = from_bits((word & 0xffffffffULL) << 20 | ONE_BITS);
  return Two<decltype(first)>{first, second};
}

// The natural logarithm of a number in (0, 1], within 1e-12: of its exponent, and by a series of
// its fraction between 1 / sqrt(2) and sqrt(2).
template <class T> INLINE T fast_log(T u) {
  constexpr double SQRT_2 = 1.4142135623730951;
  auto word = bits_of(u);
  T exponent = from_bits((word >> 52) | (1075ULL << 52)) - (4503599627370496.0 + 1023.0);
  T fraction = from_bits((word & FRACTION) | ONE_BITS);
  auto large = fraction > SQRT_2;
  fraction = select(large, 0.5 * fraction, fraction);
  exponent = select(large, exponent + 1.0, exponent);
  T s = (fraction - 1.0) / (fraction + 1.0);
  T z = s * s;
  T series = 1.0 / 13.0;
  for (int n = 11; n > 0; n -= 2) series = fma(z, series, 1.0 / n);
  return fma(exponent, LN_2, 2.0 * s * series);
}

// Two standard normal numbers from a random word: the method of Box and Muller, without branches.
template <class W> INLINE auto normals(W word) {
  auto [first, second] = uniforms(word);
  using T = decltype(first);
  T radius = sqrt(max(T(0.0), -2.0 * fast_log<T>(2.0 - first)));
  auto [sine, cosine] = sincos<T>(TURN * (second - 1.5));
  return Two<T>{radius * cosine, radius * sine};
}
}  // namespace LEVEL
