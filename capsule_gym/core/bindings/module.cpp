// The Python module `capsule_gym.core._core`, by the C API that is stable since Python 3.10. Python allocates the arrays,
// passes their addresses, and keeps them alive; `capsule_gym.core.native` checks what it passes.
#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030A0000
#endif
#include <Python.h>

#include "../physics/trajectory.hpp"
#include "functions.hpp"
#include "instruction_levels.hpp"
#include "recorded_functions.hpp"

namespace {
// --- the level of instructions ---

// Asked once: in a virtual machine the question takes microseconds.
const int BEST = best_level(), NUM_LEVELS = sizeof LEVELS / sizeof *LEVELS;
// The level that everything uses.
const Level* level = &LEVELS[BEST];

// select_level(place): that of the level in LEVELS
PyObject* select_level(PyObject*, PyObject* place) {
  level = &LEVELS[BEST + PyLong_AsLong(place)];
  Py_RETURN_NONE;
}

// --- functions ---

// call(name, *arguments) -> index of an environment whose law has failed, or -1: a function of level.cpp with whole and
// real numbers and addresses. To release the lock takes longer than a step of one environment.
template <bool releases> PyObject* call(PyObject*, PyObject* const* args, Py_ssize_t count) {
  if (count < 1 || count > 1 + MOST_ARGUMENTS) return PyErr_Format(PyExc_TypeError, "call got %zd arguments", count);
  const char* name = PyUnicode_AsUTF8AndSize(args[0], nullptr);
  Argument arguments[MOST_ARGUMENTS] = {};
  for (Py_ssize_t i = 1; i < count; i++)
    arguments[i - 1].bits =
        PyFloat_Check(args[i]) ? __builtin_bit_cast(long long, PyFloat_AsDouble(args[i])) : PyLong_AsLongLong(args[i]);
  if (PyErr_Occurred()) return nullptr;
  PyThreadState* state = releases ? PyEval_SaveThread() : nullptr;
  long long broken = level->call(name, arguments);
  if (releases) PyEval_RestoreThread(state);
  if (broken == UNKNOWN) return PyErr_Format(PyExc_ValueError, "the core has no function '%s'", name);
  // The exception is that of a law that Python calls.
  return PyErr_Occurred() ? nullptr : PyLong_FromLongLong(broken);
}

// A law that Python calls: a function of theta, theta_dot, x, x_dot, the cells of the memory, and the numbers of the
// reference, which returns a tuple of the torque and the next cells. `numbers` counts cells and reference.
struct PlainLaw {
  PyObject* function;
  long long cells, numbers, lanes, state;  // `state`: the row of the theta that the law observes
};

// The `UserLaw` with a `PlainLaw` as its data. An exception, such as that of Ctrl-C, ends the calls.
void call_plain(void* data, double* block, double* torques, long long n) {
  const auto& [function, cells, numbers, lanes, state] = *(const PlainLaw*)data;
  const double* halt = lanes == 1 ? ((Block<1>*)block)->halt : ((Block<LANES>*)block)->halt;
  PyGILState_STATE lock = PyGILState_Ensure();
  for (long long j = 0; j < n && !PyErr_Occurred(); j++) {
    if (halt[j] == HALTED) continue;
    double *observed = block + state * lanes + j, *memory = block + sizeof(Block<1>) / sizeof(double) * lanes + j;
    PyObject* given = PyTuple_New(4 + numbers);
    for (long long r = 0; r < 4 + numbers; r++)
      PyTuple_SetItem(given, r, PyFloat_FromDouble(r < 4 ? observed[r * lanes] : memory[(r - 4) * lanes]));
    PyObject* found = PyObject_CallObject(function, given);
    Py_DecRef(given);
    if (!found) continue;
    for (long long r = 0; r < cells; r++) memory[r * lanes] = PyFloat_AsDouble(PyTuple_GetItem(found, 1 + r));
    double torque = PyFloat_AsDouble(PyTuple_GetItem(found, 0));
    if (!PyErr_Occurred()) torques[j] = torque;
    Py_DecRef(found);
  }
  PyGILState_Release(lock);
}

// --- the names and constants that Python shares ---

// The names in a text, which spaces separate.
PyObject* names_in(const char* text) {
  PyObject *joined = PyUnicode_FromString(text), *names = joined ? PyUnicode_Split(joined, nullptr, -1) : nullptr;
  Py_XDECREF(joined);
  return names;
}

int fill(PyObject* module) {
  using namespace portable;
  int failed = 0;
  auto put = [&](PyObject* entries, const char* name, PyObject* value) {
    failed |= value ? PyDict_SetItemString(entries, name, value) : -1;
    Py_XDECREF(value);
  };
  PyObject *own = PyModule_GetDict(module), *laws = PyDict_New(), *tasks = PyDict_New();
  put(own, "LAWS", laws), put(own, "TASKS", tasks);
  // In the order of their numbers.
  [&]<class... Law>(List<Law...>) {
    (put(laws, Law::NAME, Py_BuildValue("(sii)", Law::CONSTANTS, Law::MEMORY, Law::COLUMNS)), ...);
  }(Laws());
  [&]<class... Task>(List<Task...>) { (put(tasks, Task::NAME, PyUnicode_FromString(Task::FIELDS)), ...); }(Tasks());
  char levels[64] = "";
  for (int i = BEST; i < NUM_LEVELS; i++) __builtin_strcat(__builtin_strcat(levels, LEVELS[i].name), " ");
#define FIELD(type, name) CAPSULE_NAME(name)
#define ROW(name) CAPSULE_NAME(name)
#define NAMES(name, text) put(own, #name, names_in(text));
  NAMES(LEVELS, levels) NAMES(ROW_NAMES, CAPSULE_ROWS) NAMES(BATCH, CAPSULE_BATCH(FIELD))
  NAMES(SETTINGS, CAPSULE_SETTINGS(CAPSULE_NAME))
  NAMES(PLANT, NOMINAL_CONSTANTS(CAPSULE_NAME)) NAMES(TRAJECTORY, CAPSULE_TRAJECTORY(CAPSULE_NAME))
  NAMES(CONSTANTS, CAPSULE_CONSTANTS(CAPSULE_NAME)) NAMES(OBSERVED, OBSERVED(CAPSULE_NAME))
#define REAL(name) put(own, #name, PyFloat_FromDouble(name));
  REAL(THETA_LIMIT) REAL(THETA_DOT_BOUND) REAL(X_DOT_BOUND) REAL(MOTOR_WIDTH) REAL(MOTOR_SLOPE)
  REAL(ERROR_BOUND) REAL(HOLD) REAL(TIME_TOLERANCE) REAL(SPEED_BOUND) REAL(MEASURED) REAL(ROUNDING)
#define WHOLE(name) put(own, #name, PyLong_FromLongLong(name));
  WHOLE(LANES) WHOLE(HISTORY_ROWS) WHOLE(MOST_CELLS) WHOLE(PADDING) WHOLE(COMMANDS) WHOLE(ESTIMATOR_CELLS)
  WHOLE(DIRECTIONS) WHOLE(MOST_RESULTS) WHOLE(CENTRED) WHOLE(LOGARITHMIC)
  put(own, "PLAIN_LAW", PyLong_FromVoidPtr((void*)&call_plain));
  using E = Estimator<double>;
  put(own, "ESTIMATES", Py_BuildValue("{s(dd)s(dd)s(dd)s(dd)}", "M_estimate", E::LOW_M, E::HIGH_M, "log_mu_estimate",
                                      E::LOW_LOG_MU, E::HIGH_LOG_MU, "M_deviation", 0.0, E::DEVIATION_M,
                                      "log_mu_deviation", 0.0, E::DEVIATION_LOG_MU));
  return failed;
}

PyMethodDef METHODS[] = {
    {"select_level", select_level, METH_O, nullptr},
    {"call", (PyCFunction)(void*)call<true>, METH_FASTCALL, nullptr},
    {"call_locked", (PyCFunction)(void*)call<false>, METH_FASTCALL, nullptr},
    {"trace", portable::trace, METH_VARARGS, nullptr},
    {nullptr, nullptr, 0, nullptr}};
PyModuleDef_Slot SLOTS[] = {{Py_mod_exec, (void*)fill}, {0, nullptr}};
PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_core", nullptr, 0, METHODS, SLOTS, nullptr, nullptr, nullptr};
}  // namespace

PyMODINIT_FUNC PyInit__core() { return PyModuleDef_Init(&MODULE); }
