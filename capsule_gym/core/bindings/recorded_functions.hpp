// Records functions of the core as lists of operations, from which Python writes them in other
// languages (capsule_gym/export/c_code.py).
#pragma once
#include <Python.h>

#include "../numbers/trace.hpp"
#include "../step/step.hpp"

namespace LEVEL {
inline PyObject* recording;  // rows for Python: the name of an operation, and its operands

inline Condition append(PyObject* row) {
  PyList_Append(recording, row);
  Py_XDECREF(row);
  return {PyList_Size(recording) - 1};
}
inline Condition append_constant(double value) {
  return append(Py_BuildValue("(sd)", "constant", value));
}
inline Condition append_row(const char* operation, int count, const long long* operands) {
  constexpr const char* FORMATS[] = {"(s)", "(sL)", "(sLL)", "(sLLL)"};
  return append(Py_BuildValue(FORMATS[count], operation, operands[0], operands[1], operands[2]));
}

// A struct of inputs, and the output of a struct.
template <class S> S given() {
  S inputs = {};
  for (int i = 0; i < WIDTH<S>; i++) ((Trace*)&inputs)[i] = Trace(append_operation("input"));
  return inputs;
}
template <class S> void give(const S& outputs) {
  for (int i = 0; i < WIDTH<S>; i++) append_operation("output", ((const Trace*)&outputs)[i]);
}

// Records a function, of a law or task with its number, and of the constants or settings. Returns
// whether there is one.
inline bool record(const char* function, long long number, const double* constants) {
  auto is = [&](const char* name) { return !__builtin_strcmp(function, name); };
  const auto& settings = *(const Settings*)constants;
  if (is("sincos")) {
    give(sincos<Trace>(given<Trace>()));
    return true;
  }
  if (is("exp")) {
    give(exp<Trace>(given<Trace>()));
    return true;
  }
  if (is("tanh")) {
    give(tanh<Trace>(given<Trace>()));
    return true;
  }
  if (is("torque")) {
    Trace law_torque = given<Trace>();
    Trace action = given<Trace>();
    give(total_torque(settings, law_torque, action));
    return true;
  }
  if (is("update_estimator")) {
    auto estimator = given<Estimator<Trace>>();
    Trace theta = given<Trace>();
    Trace theta_dot = given<Trace>();
    Trace x_dot = given<Trace>();
    update_estimator(estimator, theta, theta_dot, x_dot, assumed_pendulum(settings));
    give(estimator);
    return true;
  }
  auto trace_law = [&]<class Law>() {
    auto memory = given<typename Law::template Cells<Trace>>();
    auto state = given<State<Trace>>();
    auto row = given<typename Law::template Line<Trace>>();
    give(Law(constants).torque(state, memory, row));
    give(memory);
  };
  // A task: its memory, x, and for an observation the x of the previous one, what is observed, and
  // the estimator.
  auto trace_task = [&]<class Task>() {
    auto memory = given<typename Task::template Memory<Trace>>();
    Trace x = given<Trace>();
    if (is("begin")) Task::begin(x, x, memory);
    else {
      Trace before = given<Trace>();
      auto begun = given<Trace>() != 0.0;
      auto seen = given<Observed<Trace>>();
      double rest = settings.agent_reads != 0.0 ? settings.stick_threshold : 0.0;
      if (auto taken = when(begun))
        Task::reward(x, seen.x_dot, x - before, settings.control_dt(), rest, memory);
      auto put = [](const char*, double, double, Trace entry) { give(entry); };
      put_entries<Task>(settings, seen, memory, put, given<Estimator<Trace>>);
    }
    give(memory);
  };
  if (is("law")) return with_type(Laws(), number, trace_law);
  if (is("begin") || is("observe")) return with_type(Tasks(), number, trace_task);
  return false;
}
}  // namespace LEVEL
