// Functions that Python calls by their names, with signatures that the compiler deduces.
//
// A table of `Function`s says what each takes. module.cpp checks and converts what Python passes.
#pragma once
#include "../numbers/number.hpp"

// What a parameter takes from Python: a float, or an int that is converted; an int; an int that is
// an array's address; a str.
enum class Due { REAL, WHOLE, ADDRESS, TEXT };

// The bits of a number or of an address.
struct Argument {
  long long bits;
};
constexpr int MOST_ARGUMENTS = 7;

struct Function {
  const char* name;
  // Returns the function's result, or -1 if it has none.
  long long (*invoke)(const Argument* arguments);
  int count;  // of its arguments
  Due due[MOST_ARGUMENTS];
  // Of a function that `evaluate` evaluates: the count of its numbers, else 0, and whether it needs
  // a plant.
  int numbers;
  bool of_plant;
};

namespace LEVEL {
// How a parameter of a type reads its argument. Other types have none, and cannot be parameters.
template <class T> struct Parameter;
template <> struct Parameter<double> {
  static constexpr Due DUE = Due::REAL;
  static double read(Argument a) { return __builtin_bit_cast(double, a.bits); }
};
template <> struct Parameter<long long> {
  static constexpr Due DUE = Due::WHOLE;
  static long long read(Argument a) { return a.bits; }
};
template <> struct Parameter<bool> {
  static constexpr Due DUE = Due::WHOLE;
  static bool read(Argument a) { return a.bits != 0; }
};
template <class T> struct Parameter<T*> {
  static constexpr Due DUE = Due::ADDRESS;
  static T* read(Argument a) { return (T*)a.bits; }
};
template <class T> struct Parameter<T&> {
  static constexpr Due DUE = Due::ADDRESS;
  static T& read(Argument a) { return *(T*)a.bits; }
};
template <> struct Parameter<const char*> {
  static constexpr Due DUE = Due::TEXT;
  static const char* read(Argument a) { return (const char*)a.bits; }
};

inline Argument take(const Argument*& next) { return *next++; }

template <auto function, class... Parameters> long long invoke(const Argument* next) {
  struct Call {
    long long result = -1;
    explicit Call(Parameters... given) {
      if constexpr (requires { result = function(given...); }) result = function(given...);
      else function(given...);
    }
  };
  // Braces read the arguments in their order.
  return Call{Parameter<Parameters>::read(take(next))...}.result;
}

template <auto function, class Result, class... Parameters>
constexpr Function named(const char* name, Result (*)(Parameters...)) {
  static_assert(sizeof...(Parameters) <= MOST_ARGUMENTS);
  return {name,
          invoke<function, Parameters...>,
          sizeof...(Parameters),
          {Parameter<Parameters>::DUE...},
          0,
          false};
}
// A function by the name that Python uses.
template <auto function> constexpr Function named(const char* name) {
  return named<function>(name, function);
}
}  // namespace LEVEL
