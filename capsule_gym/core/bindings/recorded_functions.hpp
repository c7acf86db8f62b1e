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

// The torque in N m from the law's torque and the action.
inline void record_torque(const Settings& settings) {
  Trace law_torque = given<Trace>();
  Trace action = given<Trace>();
  give(total_torque(settings, law_torque, action));
}

inline void record_estimator(const Settings& settings) {
  auto estimator = given<Estimator<Trace>>();
  Trace theta = given<Trace>();
  Trace theta_dot = given<Trace>();
  Trace x_dot = given<Trace>();
  update_estimator(estimator, theta, theta_dot, x_dot, assumed_pendulum(settings));
  give(estimator);
}

template <class Law> void record_law(const double* constants) {
  auto memory = given<typename Law::template Cells<Trace>>();
  auto state = given<State<Trace>>();
  auto row = given<typename Law::template Line<Trace>>();
  give(Law(constants).torque(state, memory, row));
  give(memory);
}

// The beginning of an episode of a task.
template <class Task> void record_begin() {
  auto memory = given<typename Task::template Memory<Trace>>();
  Trace x = given<Trace>();
  Task::begin(x, x, memory);
  give(memory);
}

// The entries of an observation; with `begun` first the task's memory of the step that has ended.
template <class Task> void record_observation(const Settings& settings) {
  auto memory = given<typename Task::template Memory<Trace>>();
  Trace x = given<Trace>();
  Trace before = given<Trace>();
  auto begun = given<Trace>() != 0.0;
  auto seen = given<Observed<Trace>>();
  double rest = settings.agent_reads != 0.0 ? settings.stick_threshold : 0.0;
  if (auto taken = when(begun))
    Task::reward(x, seen.x_dot, x - before, settings.control_dt(), rest, memory);
  auto put = [](const char*, double, double, Trace entry) { give(entry); };
  put_entries<Task>(settings, seen, memory, put, given<Estimator<Trace>>);
  give(memory);
}

// Records a function, of a law or task with its number, and of the constants or settings. Returns
// whether there is one.
inline bool record(const char* function, long long number, const double* constants) {
  auto is = [&](const char* name) { return !__builtin_strcmp(function, name); };
  const auto& settings = *(const Settings*)constants;
  auto law = [&]<class Law>() { record_law<Law>(constants); };
  auto begin = [&]<class Task>() { record_begin<Task>(); };
  auto observation = [&]<class Task>() { record_observation<Task>(settings); };
  if (is("law")) return with_type(Laws(), number, law);
  if (is("begin")) return with_type(Tasks(), number, begin);
  if (is("observe")) return with_type(Tasks(), number, observation);
  if (is("sincos")) give(sincos<Trace>(given<Trace>()));
  else if (is("exp")) give(exp<Trace>(given<Trace>()));
  else if (is("tanh")) give(tanh<Trace>(given<Trace>()));
  else if (is("torque")) record_torque(settings);
  else if (is("update_estimator")) record_estimator(settings);
  else return false;
  return true;
}
}  // namespace LEVEL
