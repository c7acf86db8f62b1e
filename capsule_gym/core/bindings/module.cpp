// The Python module `capsule_gym.core._core`, by the C API that is stable since Python 3.10. Python
// allocates the arrays, passes their addresses, and keeps them alive; `capsule_gym.core.native`
// checks what it passes.
#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030A0000
#endif
#include <Python.h>

#include "../physics/trajectory.hpp"
#include "description.hpp"
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

// Reads an argument of a function, whose place counts from 1; otherwise sets an exception and
// returns false.
bool read_argument(const Function& function, Py_ssize_t place, PyObject* given,
                   Argument& argument) {
  constexpr const char* ACCEPTED[] = {"a float or an int", "an int of 64 bits",
                                      "the address of an array (int)", "a str"};
  Due due = function.due[place - 1];
  // PyLong_Check calls a function that reads the flags of the type: slower.
  bool is_int = PyObject_TypeCheck(given, &PyLong_Type);
  bool accepted = true;
  if (due == Due::TEXT) argument.bits = (long long)PyUnicode_AsUTF8AndSize(given, nullptr);
  else if (due != Due::REAL && is_int) argument.bits = PyLong_AsLongLong(given);
  else if (due == Due::REAL && (PyFloat_Check(given) || is_int))
    argument.bits = __builtin_bit_cast(long long, PyFloat_AsDouble(given));
  else accepted = false;
  // A number that is too large, or a str that is no text, sets an exception.
  if (accepted && !PyErr_Occurred()) return true;
  PyErr_Clear();
  PyErr_Format(PyExc_TypeError, "argument %zd of %s must be %s, got %.100R", place, function.name,
               ACCEPTED[(int)due], given);
  return false;
}

// Whether the arguments of `evaluate` are those of the function that it evaluates; otherwise sets
// an exception.
bool check_evaluated(const Function& function, const Argument* arguments) {
  long long numbers = arguments[1].bits;
  long long plant = arguments[4].bits;
  if (numbers != function.numbers) {
    PyErr_Format(PyExc_TypeError, "argument 2 of %s must be %d, the count of its numbers, got %lld",
                 function.name, function.numbers, numbers);
    return false;
  }
  if (function.of_plant != (plant != 0)) {
    PyErr_Format(PyExc_TypeError, "argument 5 of %s must be %s, got %lld", function.name,
                 function.of_plant ? "the address of a plant" : "0, since it needs no plant",
                 plant);
    return false;
  }
  return true;
}

// Reads all arguments of a function; otherwise sets an exception and returns false.
bool read_arguments(const Function& function, PyObject* const* given, Py_ssize_t count,
                    Argument* arguments) {
  if (count != function.count) {
    PyErr_Format(PyExc_TypeError, "%s takes %d arguments, got %zd", function.name, function.count,
                 count);
    return false;
  }
  for (Py_ssize_t i = 0; i < count; i++)
    if (!read_argument(function, i + 1, given[i], arguments[i])) return false;
  return function.numbers == 0 || check_evaluated(function, arguments);
}

// call(name, *arguments) -> index of an environment whose law has failed, or -1: a function of
// level.cpp with whole and real numbers and addresses. To release the lock takes longer than a step
// of one environment.
template <bool releases> PyObject* call(PyObject*, PyObject* const* args, Py_ssize_t count) {
  const char* name = count > 0 ? PyUnicode_AsUTF8AndSize(args[0], nullptr) : nullptr;
  if (!name)
    return PyErr_Format(PyExc_TypeError,
                        "call takes the name of a function (str) and its arguments");
  const Function* function = level->find(name);
  if (!function) return PyErr_Format(PyExc_ValueError, "the core has no function '%s'", name);
  Argument arguments[MOST_ARGUMENTS];
  if (!read_arguments(*function, args + 1, count - 1, arguments)) return nullptr;
  PyThreadState* state = releases ? PyEval_SaveThread() : nullptr;
  long long found = function->invoke(arguments);
  if (releases) PyEval_RestoreThread(state);
  // The exception is that of a law that Python calls.
  return PyErr_Occurred() ? nullptr : PyLong_FromLongLong(found);
}

// trace(function, number, constants) -> list of rows: a function of recorded_functions.hpp.
PyObject* trace(PyObject*, PyObject* const* args, Py_ssize_t count) {
  constexpr Function TRACE = portable::named<portable::record>("trace");
  Argument arguments[MOST_ARGUMENTS];
  if (!read_arguments(TRACE, args, count, arguments)) return nullptr;
  portable::recording = PyList_New(0);
  if (!portable::recording) return nullptr;
  portable::branch = {-1};
  bool known = TRACE.invoke(arguments);
  if (!known)
    PyErr_Format(PyExc_ValueError, "the core records no function %R with the number %R", args[0],
                 args[1]);
  if (PyErr_Occurred()) Py_CLEAR(portable::recording);
  return portable::recording;
}

// A tuple of `count` new objects, each from its place; a null, with an exception, where one is
// missing.
PyObject* tuple_of(long long count, auto item) {
  PyObject* tuple = PyTuple_New(count);
  for (long long n = 0; tuple && n < count; n++) {
    PyObject* value = item(n);
    if (value) PyTuple_SetItem(tuple, n, value);
    else Py_CLEAR(tuple);
  }
  return tuple;
}

// A law that Python calls: a function of theta, theta_dot, x, x_dot, the cells of the memory, and
// the numbers of the reference, which returns a tuple of the torque and the next cells. `numbers`
// counts cells and reference.
struct PlainLaw {
  PyObject* function;
  long long cells, numbers, lanes, state;  // `state`: the row of the theta that the law observes
};

// The `UserLaw` with a `PlainLaw` as its data. An exception, such as that of Ctrl-C, ends the
// calls.
void call_plain(void* data, double* block, double* torques, long long n) {
  const auto& [function, cells, numbers, lanes, state] = *(const PlainLaw*)data;
  const double* halt = lanes == 1 ? ((Block<1>*)block)->halt : ((Block<LANES>*)block)->halt;
  PyGILState_STATE lock = PyGILState_Ensure();
  for (long long j = 0; j < n && !PyErr_Occurred(); j++) {
    if (halt[j] == HALTED) continue;
    const double* observed = block + state * lanes + j;
    double* memory = block + NUM_ROWS * lanes + j;
    PyObject* given = tuple_of(4 + numbers, [=](long long r) {
      return PyFloat_FromDouble(r < 4 ? observed[r * lanes] : memory[(r - 4) * lanes]);
    });
    PyObject* found = given ? PyObject_CallObject(function, given) : nullptr;
    Py_XDECREF(given);
    if (!found) continue;
    for (long long r = 0; r < cells; r++)
      memory[r * lanes] = PyFloat_AsDouble(PyTuple_GetItem(found, 1 + r));
    double torque = PyFloat_AsDouble(PyTuple_GetItem(found, 0));
    if (!PyErr_Occurred()) torques[j] = torque;
    Py_DecRef(found);
  }
  PyGILState_Release(lock);
}

// --- the names and constants that Python shares ---

// The names in a text, which spaces separate.
PyObject* names_in(const char* text) {
  PyObject* joined = PyUnicode_FromString(text);
  PyObject* names = joined ? PyUnicode_Split(joined, nullptr, -1) : nullptr;
  Py_XDECREF(joined);
  return names;
}

// Puts a new object into a dict; returns whether that has failed.
bool put_item(PyObject* entries, const char* name, PyObject* value) {
  bool failed = !entries || !value || PyDict_SetItemString(entries, name, value) < 0;
  Py_XDECREF(value);
  return failed;
}

// Appends a new object to a list; where one of both is missing, the exception stays for the end.
void append(PyObject* list, PyObject* value) {
  if (list && value) PyList_Append(list, value);
  Py_XDECREF(value);
}

// Types of named tuples, and the names of the options (a list); `fill` makes them.
PyObject *settings_type, *layout_type, *description_type, *task_type, *option_names;

// A type of tuples with named fields, by `collections.namedtuple`.
PyObject* named_tuple_type(const char* name, const char* fields) {
  PyObject* collections = PyImport_ImportModule("collections");
  PyObject* make = collections ? PyObject_GetAttrString(collections, "namedtuple") : nullptr;
  PyObject* arguments = Py_BuildValue("(ss)", name, fields);
  PyObject* module = Py_BuildValue("{ss}", "module", "capsule_gym.core._core");
  PyObject* type = make && arguments && module ? PyObject_Call(make, arguments, module) : nullptr;
  PyObject* used[] = {collections, make, arguments, module};
  for (PyObject* each : used) Py_XDECREF(each);
  return type;
}

PyObject* as_object(double number) { return PyFloat_FromDouble(number); }
PyObject* as_object(long long number) { return PyLong_FromLongLong(number); }

// A tuple of this type from a struct of numbers.
template <class Number, class Struct> PyObject* named_tuple(PyObject* type, const Struct& numbers) {
  constexpr int COUNT = sizeof(Struct) / sizeof(Number);
  auto value = [&](long long n) { return as_object(((const Number*)&numbers)[n]); };
  PyObject* values = tuple_of(COUNT, value);
  PyObject* found = values ? PyObject_CallObject(type, values) : nullptr;
  Py_XDECREF(values);
  return found;
}

// Reads an option by its name, a str; NaN where it is missing or None. Returns whether it is there.
bool read_option(PyObject* options, PyObject* name, double& option) {
  PyObject* value = PyDict_GetItemWithError(options, name);
  option = __builtin_nan("");
  if (!value) return false;
  if (value == Py_None) return true;
  option = PyFloat_AsDouble(value);
  if (PyErr_Occurred())
    PyErr_Format(PyExc_TypeError, "the option %R must be a number or None, got %R", name, value);
  return true;
}

// describe(options) -> Description: what follows from options by their names.
PyObject* describe(PyObject*, PyObject* options) {
  using namespace portable;
  if (!PyDict_Check(options))
    return PyErr_Format(PyExc_TypeError, "options must be a dict, got %R", options);
  Options o;
  Py_ssize_t found = 0;
  for (Py_ssize_t n = 0; n < PyList_Size(option_names); n++)
    found += read_option(options, PyList_GetItem(option_names, n), ((double*)&o)[n]);
  if (PyErr_Occurred()) return nullptr;
  if (found != PyDict_Size(options))
    return PyErr_Format(PyExc_TypeError, "the core has no option of a name in %R", options);
  Description d;
  bool known = describe_environment(o, d, [](size_t bytes) { return PyMem_Malloc(bytes); });
  if (!known) return PyErr_Format(PyExc_ValueError, "the core has no task of this number");
  if (!d.entries) return PyErr_NoMemory();
  PyObject* entries = PyList_New(0);
  for (long long k = 0; k < d.layout.entries; k++) {
    const auto& [name, age, low, high] = d.entries[k];
    PyObject* aged =
        age ? PyUnicode_FromFormat("%s %d", name, (int)age) : PyUnicode_FromString(name);
    append(entries, Py_BuildValue("Ndd", aged, low, high));
  }
  PyObject* draws = PyList_New(0);
  for (long long k = 0; k < d.layout.draws; k++) {
    const auto& [row, stream, place, low, range, distribution] = d.draws[k];
    append(draws, Py_BuildValue("dddddd", row, stream, place, low, range, distribution));
  }
  PyMem_Free(d.entries);
  // With an exception, calls would report that instead.
  bool failed = PyErr_Occurred() != nullptr;
  PyObject* settings = failed ? nullptr : named_tuple<double>(settings_type, d.settings);
  PyObject* layout = settings ? named_tuple<long long>(layout_type, d.layout) : nullptr;
  return PyObject_CallFunction(description_type, "NNNN", settings, layout, entries, draws);
}

// What Python knows of a task: a tuple of type `TaskDescription`.
template <class Task> PyObject* describe_task(PyObject* shared_metrics) {
  using namespace portable;
  PyObject* draws = PyList_New(0);
  Task::draws(NOT_GIVEN, [&](const char* option, double low, double high, double distribution) {
    append(draws, Py_BuildValue("sddd", option, low, high, distribution));
  });
  PyObject* metrics = PyDict_New();
  describe_metrics<Task>([&](const char* name, const char* description) {
    if (!PyDict_GetItemString(shared_metrics, name))
      put_item(metrics, name, PyUnicode_FromString(description));
  });
  return PyObject_CallFunction(task_type, "NNsiNN", names_in(Task::FIELDS), names_in(Task::SHOWN),
                               Task::TERM, Task::STEPS, draws, metrics);
}

// The laws by name, in the order of their numbers: names of constants, sizes of the memory and of a
// row of the reference.
PyObject* describe_laws() {
  using namespace portable;
  PyObject* laws = PyDict_New();
  [&]<class... Law>(List<Law...>) {
    (put_item(laws, Law::NAME, Py_BuildValue("(sii)", Law::CONSTANTS, Law::MEMORY, Law::COLUMNS)),
     ...);
  }(Laws());
  return laws;
}

// The tasks by name, in the order of their numbers.
PyObject* describe_tasks(PyObject* shared_metrics) {
  using namespace portable;
  PyObject* tasks = PyDict_New();
  [&]<class... Task>(List<Task...>) {
    (put_item(tasks, Task::NAME, describe_task<Task>(shared_metrics)), ...);
  }(Tasks());
  return tasks;
}

// The metrics that all tasks share: those of the task that adds none.
PyObject* describe_shared_metrics() {
  PyObject* metrics = PyDict_New();
  portable::describe_metrics<portable::Speed>([&](const char* name, const char* description) {
    put_item(metrics, name, PyUnicode_FromString(description));
  });
  return metrics;
}

// A class with the number of each row.
PyObject* row_class() {
  PyObject* rows = PyDict_New();
  long long row = 0;
#define ROW(name) put_item(rows, #name, PyLong_FromLongLong(row++));
  CAPSULE_ROWS
#undef ROW
  return PyObject_CallFunction((PyObject*)&PyType_Type, "s()N", "Row", rows);
}

// Puts the constants; returns whether that has failed.
bool put_constants(PyObject* own) {
  using namespace portable;
  bool failed = false;
#define REAL(name) failed |= put_item(own, #name, PyFloat_FromDouble(name));
  REAL(THETA_LIMIT)
  REAL(THETA_DOT_BOUND)
  REAL(MOTOR_WIDTH)
  REAL(MOTOR_SLOPE)
  REAL(ROUNDING)
  REAL(LARGEST_COMMAND)
  REAL(START_THETA)
  REAL(M_BOUND)
  REAL(MU_BOUND)
  REAL(CONTROL_DT)
  REAL(DIRECT_PHYSICS_DT)
  REAL(LAW_PHYSICS_DT)
#undef REAL
#define WHOLE(name) failed |= put_item(own, #name, PyLong_FromLongLong(name));
  WHOLE(LANES)
  WHOLE(MOST_CELLS)
  WHOLE(PADDING)
  WHOLE(HEADER_SIZE)
  WHOLE(GRU)
  WHOLE(LSTM)
  WHOLE(COMMANDS)
  WHOLE(ESTIMATOR_CELLS)
  WHOLE(DIRECTIONS)
  WHOLE(MOST_RESULTS)
  WHOLE(MOST_SUBSTEPS)
  WHOLE(MOST_N)
#undef WHOLE
  return failed;
}

int fill(PyObject* module) {
  using namespace portable;
  PyObject* own = PyModule_GetDict(module);
  bool failed = false;
  auto put = [&](const char* name, PyObject* value) {
    failed |= put_item(own, name, value);
    return value;
  };
  auto put_type = [&](const char* name, const char* fields) {
    PyObject* type = named_tuple_type(name, fields);
    // Another load of the module may be freed while this one is used.
    Py_XINCREF(type);
    return put(name, type);
  };
  settings_type = put_type("Settings", CAPSULE_SETTINGS(CAPSULE_NAME));
  layout_type = put_type("Layout", CAPSULE_LAYOUT(CAPSULE_NAME));
  description_type = put_type("Description", "settings layout entries draws");
  task_type = put_type("TaskDescription", "fields shown term steps draws metrics");
  if (failed) return -1;
  PyObject* metrics = describe_shared_metrics();
  if (!metrics) return -1;
  put("TASKS", describe_tasks(metrics));
  put("METRICS", metrics);
  put("LAWS", describe_laws());
  put("Row", row_class());
  PyObject* levels = PyList_New(0);
  for (int i = BEST; i < NUM_LEVELS; i++) append(levels, PyUnicode_FromString(LEVELS[i].name));
  put("LEVELS", levels);
  for (auto [list, names] : NAME_LISTS) put(list, names_in(names));
  put("PLANT", names_in(NOMINAL_CONSTANTS(CAPSULE_NAME)));
  put("OBSERVED", names_in(OBSERVED(CAPSULE_NAME)));
  put("TRAJECTORY", names_in(CAPSULE_TRAJECTORY(CAPSULE_NAME)));
  put("STREAMS", names_in(CAPSULE_STREAMS(CAPSULE_NAME)));
  option_names = names_in(OPTION_NAMES);
  put("PLAIN_LAW", PyLong_FromVoidPtr((void*)&call_plain));
  failed |= put_constants(own);
  return failed || PyErr_Occurred() ? -1 : 0;
}

PyMethodDef METHODS[] = {{"select_level", select_level, METH_O, nullptr},
                         {"call", (PyCFunction)(void*)call<true>, METH_FASTCALL, nullptr},
                         {"call_locked", (PyCFunction)(void*)call<false>, METH_FASTCALL, nullptr},
                         {"describe", describe, METH_O, nullptr},
                         {"trace", (PyCFunction)(void*)trace, METH_FASTCALL, nullptr},
                         {nullptr, nullptr, 0, nullptr}};
PyModuleDef_Slot SLOTS[] = {{Py_mod_exec, (void*)fill}, {0, nullptr}};
PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, "_core", nullptr, 0, METHODS, SLOTS, nullptr, nullptr, nullptr};
}  // namespace

PyMODINIT_FUNC PyInit__core() { return PyModuleDef_Init(&MODULE); }
