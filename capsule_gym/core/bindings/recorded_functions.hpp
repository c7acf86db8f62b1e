// A number type that records what is computed with it, from which Python writes the core's functions in other languages
// (capsule_gym/trace.py).
//
// A recording is a list of rows for Python: the name of an operation, and the places of its operands in the list, or a
// constant's value. A branch, `when`, is always taken; assignments in it select between the new value and the old one.
#pragma once
#include <Python.h>

#include "functions.hpp"

namespace LEVEL {
struct Condition { long long place; };
inline struct {
  PyObject* rows;
  Condition taken;  // of the present branch; the place is -1 outside of branches
} recording;

inline Condition append(PyObject* row) {
  PyList_Append(recording.rows, row);
  Py_XDECREF(row);
  return {PyList_Size(recording.rows) - 1};
}
template <class... Operands> Condition record(const char* operation, const Operands&... operands) {
  constexpr const char* FORMATS[] = {"(s)", "(sL)", "(sLL)", "(sLLL)"};
  return append(Py_BuildValue(FORMATS[sizeof...(operands)], operation, operands.place...));
}

struct Trace {
  long long place;
  Trace() = default;
  Trace(const Trace&) = default;
  Trace(double value) : Trace(append(Py_BuildValue("(sd)", "constant", value))) {}
  explicit Trace(Condition recorded) : place(recorded.place) {}
  Trace& operator=(const Trace& value) {
    Condition taken = recording.taken;
    place = taken.place < 0 ? value.place : record("select", taken, value, *this).place;
    return *this;
  }
};

#define UNARY(R, T, function, name) inline R function(T a) { return R(record(#name, a)); }
#define BINARY(R, T, function, name) inline R function(T a, T b) { return R(record(#name, a, b)); }
BINARY(Trace, Trace, operator+, add) BINARY(Trace, Trace, operator-, subtract) BINARY(Trace, Trace, operator*, multiply)
BINARY(Trace, Trace, operator/, divide) UNARY(Trace, Trace, operator-, negate)
BINARY(Condition, Trace, operator<, less) BINARY(Condition, Trace, operator<=, less_equal)
BINARY(Condition, Trace, operator==, equal) BINARY(Condition, Condition, operator&, both)
BINARY(Condition, Condition, operator|, either) UNARY(Condition, Condition, operator!, inverse)
UNARY(Trace, Trace, abs, absolute) UNARY(Trace, Trace, sqrt, square_root) BINARY(Trace, Trace, copysign, copysign)
UNARY(Trace, Trace, power_of_two, power_of_two) UNARY(Trace, Trace, exp, exp) UNARY(Trace, Trace, tanh, tanh)
inline Condition operator>(Trace a, Trace b) { return b < a; }
inline Condition operator>=(Trace a, Trace b) { return b <= a; }
inline Condition operator!=(Trace a, Trace b) { return !(a == b); }
inline Trace fma(Trace a, Trace b, Trace c) { return Trace(record("fma", a, b, c)); }
inline Trace select(Condition condition, Trace a, Trace b) { return Trace(record("select", condition, a, b)); }
inline SinCos<Trace> sincos(Trace angle) {
  auto both = record("sincos", angle);
  return {Trace(record("sine", both)), Trace(record("cosine", both))};
}

struct Taken {
  Condition before = recording.taken;
  explicit Taken(Condition c) { recording.taken = before.place < 0 ? c : record("both", before, c); }
  Taken(const Taken&) = delete;
  ~Taken() { recording.taken = before; }
  operator bool() const { return true; }
};
inline Taken when(Condition condition) { return Taken(condition); }

// A struct of inputs, and the output of a struct.
template <class S> S given() {
  S inputs = {};
  for (int i = 0; i < WIDTH<S>; i++) ((Trace*)&inputs)[i] = Trace(record("input"));
  return inputs;
}
template <class S> void give(const S& outputs) {
  for (int i = 0; i < WIDTH<S>; i++) record("output", ((const Trace*)&outputs)[i]);
}

// trace(function, number, constants) -> list of rows: records a function, of a law or task with its number, and of the
// constants or settings, by the address of an array.
inline PyObject* trace(PyObject*, PyObject* arguments) {
  const char* function;
  long long number, address;
  if (!PyArg_ParseTuple(arguments, "sLL", &function, &number, &address)) return nullptr;
  const auto* constants = (const double*)address;
  recording = {PyList_New(0), {-1}};
  auto is = [&](const char* name) { return !__builtin_strcmp(function, name); };
  const auto& settings = *(const Settings*)constants;
  if (is("sincos")) give(sincos<Trace>(given<Trace>()));
  if (is("exp")) give(exp<Trace>(given<Trace>()));
  if (is("tanh")) give(tanh<Trace>(given<Trace>()));
  if (is("torque")) {
    Trace law_torque = given<Trace>(), action = given<Trace>();
    give(total_torque(settings, law_torque, action));
  }
  if (is("identify")) {
    auto filter = given<Filter<Trace>>();
    Trace theta = given<Trace>(), theta_dot = given<Trace>(), x_dot = given<Trace>();
    identify(filter, theta, theta_dot, x_dot, assumed_pendulum(settings));
    give(filter);
  }
  auto trace_law = [&]<class Law>() {
    auto memory = given<typename Law::template Cells<Trace>>();
    auto state = given<State<Trace>>();
    auto row = given<typename Law::template Line<Trace>>();
    give(Law(constants).torque(state, memory, row)), give(memory);
  };
  // A task: its memory, x, and for an observation the x of the previous one, what is observed, and the filter.
  auto trace_task = [&]<class Task>() {
    auto memory = given<typename Task::template Memory<Trace>>();
    Trace x = given<Trace>();
    if (is("begin")) Task::begin(x, x, memory);
    else {
      Trace before = given<Trace>();
      auto begun = given<Trace>() != 0.0;
      auto seen = given<Observed<Trace>>();
      double rest = settings.agent_reads != 0.0 ? settings.stick_threshold : 0.0;
      if (auto taken = when(begun)) Task::reward(x, seen.x_dot, x - before, settings.control_dt(), rest, memory);
      put_entries<Task>(settings, seen, memory, give<Trace>, given<Filter<Trace>>);
    }
    give(memory);
  };
  if (is("law")) with_type(Laws(), number, trace_law);
  if (is("begin") || is("observe")) with_type(Tasks(), number, trace_task);
  if (PyErr_Occurred()) Py_CLEAR(recording.rows);
  return recording.rows;
}
}  // namespace LEVEL
