// The entry points of the core at one level of instructions.
#pragma once
#include "layout.hpp"

// An argument of `Level::call`: a whole or real number, or an address.
struct Argument {
  long long bits;
  operator long long() const { return bits; }
  operator double() const { return __builtin_bit_cast(double, bits); }
  template <class T> operator T*() const { return (T*)bits; }
};
constexpr int MOST_ARGUMENTS = 9;
// What `Level::call` returns where there is no function of this name.
constexpr long long UNKNOWN = -3;

struct Level {
  const char* name;
  long long (*advance)(const Batch&, long long first, long long last, bool begin);
  // Calls a function by its name, see level.cpp.
  long long (*call)(const char* function, const Argument* arguments);
};
