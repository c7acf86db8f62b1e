// The Python module `capsule_gym._core`: the plain C API, limited to what is stable since Python 3.10, so that one module
// serves all Pythons. Python allocates the arrays, passes their addresses, and keeps them alive; `capsule_gym.native`
// checks what it passes.
#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030A0000
#endif
#include <Python.h>
#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include "functions.hpp"
#include "level.hpp"
#include "network.hpp"
#include "step.hpp"

extern "C" const Level capsule_level_portable;
#if defined(__x86_64__)
extern "C" const Level capsule_level_v3, capsule_level_v4;
#endif

namespace {

// The best level first.
const Level* const LEVELS[] = {
#if defined(__x86_64__)
    &capsule_level_v4, &capsule_level_v3,
#endif
    &capsule_level_portable};

#if defined(__x86_64__)
// The processor itself answers: zig's runtime lacks what `__builtin_cpu_supports` reads, and says no to everything.
int x86_level() {
  unsigned a, b, c, d, low, high;
  if (__get_cpuid_max(0, nullptr) < 7) return 1;
  __cpuid(1, a, b, c, d);
  bool fma = c >> 12 & 1, saves = c >> 27 & 1;
  if (!fma || !saves) return 1;
  __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  __cpuid_count(7, 0, a, b, c, d);
  const unsigned V3 = 1u << 3 | 1u << 5 | 1u << 8, V4 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
  if ((low & 6) != 6 || (b & V3) != V3) return 1;
  return (low & 0xe6) == 0xe6 && (b & V4) == V4 ? 4 : 3;
}
// Asked once: in a virtual machine the question takes microseconds.
const int X86_LEVEL = x86_level();
#endif

bool runs(const Level* level) {
#if defined(__x86_64__)
  if (level == &capsule_level_v4) return X86_LEVEL == 4;
  if (level == &capsule_level_v3) return X86_LEVEL >= 3;
#endif
  return level == &capsule_level_portable;
}

// The level of a name; a null pointer with an exception if this processor does not run it.
const Level* find_level(const char* name) {
  for (auto level : LEVELS)
    if (!__builtin_strcmp(level->name, name) && runs(level)) return level;
  PyErr_Format(PyExc_ValueError, "level must be one that this processor runs, got '%s'", name);
  return nullptr;
}

typedef unsigned long long Address;

// --- batches ---

struct Bound {
  Batch batch;
  const Level* level;
};

Bound* bound_of(PyObject* handle) { return (Bound*)PyCapsule_GetPointer(handle, "Batch"); }
void release(PyObject* handle) { PyMem_Free(bound_of(handle)); }

// bind(level, fields) -> handle: the fields of `Batch` by their names; arrays and functions by their addresses
PyObject* bind(PyObject*, PyObject* args) {
  const char* name;
  PyObject* fields;
  if (!PyArg_ParseTuple(args, "sO", &name, &fields)) return nullptr;
  Bound bound = {{}, find_level(name)};
  if (!bound.level) return nullptr;
#define FIELD(type, field)                                                                        \
  {                                                                                               \
    PyObject* value = PyDict_GetItemString(fields, #field);                                       \
    if (!value) return PyErr_Format(PyExc_KeyError, #field);                                      \
    bound.batch.field = (type)PyLong_AsUnsignedLongLong(value);                                   \
  }
  CAPSULE_BATCH(FIELD)
#undef FIELD
  if (PyErr_Occurred()) return nullptr;
  Bound* kept = (Bound*)PyMem_Malloc(sizeof bound);
  if (!kept) return PyErr_NoMemory();
  *kept = bound;
  return PyCapsule_New(kept, "Batch", release);
}

// advance(handle, first, last, begin) -> index of an environment whose law has failed, or -1; releases the lock
PyObject* advance(PyObject*, PyObject* const* args, Py_ssize_t count) {
  if (count != 4) return PyErr_Format(PyExc_TypeError, "advance takes 4 arguments, got %zd", count);
  Bound* bound = bound_of(args[0]);
  if (!bound) return nullptr;
  long long first = PyLong_AsLongLong(args[1]), last = PyLong_AsLongLong(args[2]), begin = PyLong_AsLongLong(args[3]);
  if (PyErr_Occurred()) return nullptr;
  PyThreadState* state = PyEval_SaveThread();
  long long broken = bound->level->advance(bound->batch, first, last, begin != 0);
  PyEval_RestoreThread(state);
  // Of a law that Python calls.
  return PyErr_Occurred() ? nullptr : PyLong_FromLongLong(broken);
}

// step_one(handle, action) -> as `advance`: one step of a single environment, which takes less time than to release the
// lock
PyObject* step_one(PyObject*, PyObject* const* args, Py_ssize_t count) {
  if (count != 2) return PyErr_Format(PyExc_TypeError, "step_one takes 2 arguments, got %zd", count);
  Bound* bound = bound_of(args[0]);
  if (!bound) return nullptr;
  double action = PyFloat_AsDouble(args[1]);
  if (PyErr_Occurred()) return nullptr;
  ((Block<1>*)bound->batch.world)->action[0] = action;
  long long broken = bound->level->advance(bound->batch, 0, 1, false);
  return PyErr_Occurred() ? nullptr : PyLong_FromLongLong(broken);
}

// draw_episodes(handle, count), begin_episodes(handle, count): see resets.hpp
template <auto function> PyObject* call_with_count(PyObject*, PyObject* const* args, Py_ssize_t count) {
  if (count != 2) return PyErr_Format(PyExc_TypeError, "expected 2 arguments, got %zd", count);
  Bound* bound = bound_of(args[0]);
  long long n = bound ? PyLong_AsLongLong(args[1]) : 0;
  if (PyErr_Occurred()) return nullptr;
  (bound->level->*function)(bound->batch, n);
  Py_RETURN_NONE;
}

// --- functions over arrays ---

// evaluate(level, function, in, out, n, settings): see functions.hpp; `settings` is 0 for elementary functions
PyObject* evaluate(PyObject*, PyObject* args) {
  const char* name;
  int function;
  Address in, out, settings;
  long long n;
  if (!PyArg_ParseTuple(args, "siKKLK", &name, &function, &in, &out, &n, &settings)) return nullptr;
  const Level* level = find_level(name);
  if (!level) return nullptr;
  PyThreadState* state = PyEval_SaveThread();
  level->evaluate(function, (const double*)in, (double*)out, n, (const Settings*)settings);
  PyEval_RestoreThread(state);
  Py_RETURN_NONE;
}

// law_torques(level, law, constants, states, memory, rows, torques, n): see level.hpp
PyObject* law_torques(PyObject*, PyObject* args) {
  const char* name;
  long long law, n;
  Address constants, states, memory, rows, torques;
  if (!PyArg_ParseTuple(args, "sLKKKKKL", &name, &law, &constants, &states, &memory, &rows, &torques, &n)) return nullptr;
  const Level* level = find_level(name);
  if (!level) return nullptr;
  level->law_torques(law, (const double*)constants, (const double*)states, (double*)memory, (const double*)rows,
                     (double*)torques, n);
  Py_RETURN_NONE;
}

// platform_motion(level, angle, velocity, acceleration, plant, motion, n, h): see level.hpp
PyObject* platform_motion(PyObject*, PyObject* args) {
  const char* name;
  Address angle, velocity, acceleration, plant, motion;
  long long n;
  double h;
  if (!PyArg_ParseTuple(args, "sKKKKKLd", &name, &angle, &velocity, &acceleration, &plant, &motion, &n, &h)) return nullptr;
  const Level* level = find_level(name);
  if (!level) return nullptr;
  level->platform_motion((const double*)angle, (const double*)velocity, (const double*)acceleration,
                         (const double*)plant, (double*)motion, n, h);
  Py_RETURN_NONE;
}

// --- trained policies ---

// act_batch(level, network, observations, entries, n, memory, actions): see network.hpp; releases the lock
PyObject* act_batch(PyObject*, PyObject* args) {
  const char* name;
  Address network, observations, memory, actions;
  long long entries, n;
  if (!PyArg_ParseTuple(args, "sKKLLKK", &name, &network, &observations, &entries, &n, &memory, &actions)) return nullptr;
  const Level* level = find_level(name);
  if (!level) return nullptr;
  PyThreadState* state = PyEval_SaveThread();
  bool enough = level->act_batch((const double*)network, (const float*)observations, entries, n, (double*)memory,
                                 (float*)actions);
  PyEval_RestoreThread(state);
  if (!enough) return PyErr_NoMemory();
  Py_RETURN_NONE;
}

// run_episodes(batch, first, last, steps, control_dt, network, memory, changes, num_changes) -> as `advance`; see
// rollout.hpp; releases the lock
PyObject* run_episodes(PyObject*, PyObject* args) {
  PyObject* handle;
  Address network, memory, changes;
  long long first, last, steps, num_changes;
  double control_dt;
  if (!PyArg_ParseTuple(args, "OLLLdKKKL", &handle, &first, &last, &steps, &control_dt, &network, &memory, &changes,
                        &num_changes))
    return nullptr;
  Bound* bound = bound_of(handle);
  if (!bound) return nullptr;
  PyThreadState* state = PyEval_SaveThread();
  long long broken = bound->level->run_episodes(bound->batch, first, last, steps, control_dt, (const double*)network,
                                                (double*)memory, (const double*)changes, num_changes);
  PyEval_RestoreThread(state);
  if (broken == NO_MEMORY) return PyErr_NoMemory();
  return PyErr_Occurred() ? nullptr : PyLong_FromLongLong(broken);
}

// write_inputs(level, header, observations, entries, n, memory, inputs): see network.hpp
PyObject* write_inputs(PyObject*, PyObject* args) {
  const char* name;
  Address header, observations, memory, inputs;
  long long entries, n;
  if (!PyArg_ParseTuple(args, "sKKLLKK", &name, &header, &observations, &entries, &n, &memory, &inputs)) return nullptr;
  const Level* level = find_level(name);
  if (!level) return nullptr;
  level->write_inputs((const double*)header, (const float*)observations, entries, n, (double*)memory, (float*)inputs);
  Py_RETURN_NONE;
}

// --- laws that Python calls ---

struct PlainLaw {
  PyObject* law;
  long long memory_size, reference_size, lanes, first;  // `first`: the row of the memory in a block
};

PlainLaw* plain_of(PyObject* handle) { return (PlainLaw*)PyCapsule_GetPointer(handle, "PlainLaw"); }

void release_plain(PyObject* handle) {
  PlainLaw* plain = plain_of(handle);
  Py_DecRef(plain->law);
  PyMem_Free(plain);
}

PyObject* tuple_of(const double* values, long long size, long long stride) {
  PyObject* tuple = PyTuple_New(size);
  for (long long r = 0; tuple && r < size; r++) PyTuple_SetItem(tuple, r, PyFloat_FromDouble(values[r * stride]));
  return tuple;
}

// Calls the law for one environment; returns NaN with an exception set if it fails.
double call_plain_once(const PlainLaw& p, const double* state, double* memory) {
  PyObject *cells = tuple_of(memory, p.memory_size, p.lanes),
           *row = tuple_of(memory + p.memory_size * p.lanes, p.reference_size, p.lanes);
  PyObject* found = PyObject_CallFunction(p.law, "ddddNN", state[0], state[p.lanes], state[2 * p.lanes],
                                          state[3 * p.lanes], cells, row);
  if (!found) return __builtin_nan("");
  PyObject* pair = PySequence_Tuple(found);
  PyObject* renewed = pair && PyTuple_Size(pair) == 2 ? PySequence_Tuple(PyTuple_GetItem(pair, 1)) : nullptr;
  double torque = __builtin_nan("");
  if (renewed && PyTuple_Size(renewed) == p.memory_size) {
    torque = PyFloat_AsDouble(PyTuple_GetItem(pair, 0));
    for (long long r = 0; r < p.memory_size; r++) memory[r * p.lanes] = PyFloat_AsDouble(PyTuple_GetItem(renewed, r));
  } else if (!PyErr_Occurred()) {
    PyErr_Format(PyExc_TypeError, "a control law must return (torque, memory) with %lld cells of memory", p.memory_size);
  }
  Py_XDECREF(renewed);
  Py_XDECREF(pair);
  Py_DecRef(found);
  return PyErr_Occurred() ? __builtin_nan("") : torque;
}

void call_plain(void* data, double* block, double* torques, long long n) {
  const PlainLaw& p = *(const PlainLaw*)data;
  const double* halt = p.lanes == 1 ? ((Block<1>*)block)->halt : ((Block<LANES>*)block)->halt;
  PyGILState_STATE lock = PyGILState_Ensure();
  // The first exception, which `advance` raises. One that is no `Exception`, such as Ctrl-C, replaces it and ends the calls.
  PyObject *type, *value, *trace;
  PyErr_Fetch(&type, &value, &trace);
  bool stops = type && !PyErr_GivenExceptionMatches(type, PyExc_Exception);
  for (long long j = 0; j < n; j++) {
    torques[j] = __builtin_nan("");
    if (halt[j] == HALTED || stops) continue;
    torques[j] = call_plain_once(p, block + j, block + p.first * p.lanes + j);
    if (!PyErr_Occurred()) continue;
    stops = !PyErr_ExceptionMatches(PyExc_Exception);
    if (type && !stops) {
      PyErr_Clear();
      continue;
    }
    Py_XDECREF(type), Py_XDECREF(value), Py_XDECREF(trace);
    PyErr_Fetch(&type, &value, &trace);
  }
  PyErr_Restore(type, value, trace);
  PyGILState_Release(lock);
}

// plain_law(law, memory_size, reference_size, lanes) -> (handle, address of the function, address of its data)
PyObject* plain_law(PyObject*, PyObject* args) {
  PlainLaw p;
  if (!PyArg_ParseTuple(args, "OLLL", &p.law, &p.memory_size, &p.reference_size, &p.lanes)) return nullptr;
  p.first = sizeof(Block<1>) / sizeof(double);
  PlainLaw* kept = (PlainLaw*)PyMem_Malloc(sizeof p);
  if (!kept) return PyErr_NoMemory();
  *kept = p;
  Py_IncRef(p.law);
  return Py_BuildValue("NKK", PyCapsule_New(kept, "PlainLaw", release_plain), (Address)&call_plain, (Address)kept);
}

// --- the names that Python shares ---

// Adds a tuple of the names in a text, which spaces separate.
int add_names(PyObject* module, const char* name, const char* text) {
  PyObject *joined = PyUnicode_FromString(text), *list = joined ? PyUnicode_Split(joined, nullptr, -1) : nullptr;
  PyObject* names = list ? PyList_AsTuple(list) : nullptr;
  Py_XDECREF(joined);
  Py_XDECREF(list);
  return names ? PyModule_AddObject(module, name, names) : -1;
}

int fill(PyObject* module) {
  char levels[64] = "";
  for (auto level : LEVELS)
    if (runs(level)) __builtin_strcat(__builtin_strcat(levels, level->name), " ");
  int failed = add_names(module, "LEVELS", levels);
#define ROW(name) #name " "
  failed |= add_names(module, "ROWS", CAPSULE_ROWS);
#undef ROW
#define FIELD(name) #name " "
  failed |= add_names(module, "SETTINGS", CAPSULE_SETTINGS(FIELD));
  failed |= add_names(module, "PLANT", CAPSULE_PLANT(FIELD));
  failed |= add_names(module, "NETWORK", CAPSULE_NETWORK(FIELD));
#undef FIELD
#define FIELD(type, name) #name " "
  failed |= add_names(module, "BATCH", CAPSULE_BATCH(FIELD));
#undef FIELD
#define F(name, arguments, results, call) #name ":" #arguments ":" #results " "
  failed |= add_names(module, "PLANT_FUNCTIONS", CAPSULE_PLANT_FUNCTIONS(F));
  failed |= add_names(module, "ELEMENTARY_FUNCTIONS", CAPSULE_ELEMENTARY_FUNCTIONS(F));
#undef F
  // By the order of their numbers: name, then what its arrays hold.
  PyObject *laws = PyDict_New(), *tasks = PyDict_New();
  if (!laws || !tasks) return -1;
#define LAW(Law)                                                                                                        \
  {                                                                                                                     \
    PyObject* value = Py_BuildValue("(sii)", portable::Law::CONSTANTS, portable::Law::MEMORY, portable::Law::COLUMNS); \
    failed |= value ? PyDict_SetItemString(laws, portable::Law::NAME, value) : -1;                                      \
    Py_XDECREF(value);                                                                                                  \
  }
  CAPSULE_LAWS(LAW)
#undef LAW
#define TASK(Task)                                                                                       \
  {                                                                                                      \
    PyObject* value = Py_BuildValue("(si)", portable::Task::FIELDS, portable::Task::ENTRIES);            \
    failed |= value ? PyDict_SetItemString(tasks, portable::Task::NAME, value) : -1;                     \
    Py_XDECREF(value);                                                                                   \
  }
  CAPSULE_TASKS(TASK)
#undef TASK
  failed |= PyModule_AddObject(module, "LAWS", laws) | PyModule_AddObject(module, "TASKS", tasks);
  // Constants of the core that Python needs too.
#define CONSTANT(name) failed |= PyModule_AddObject(module, #name, PyFloat_FromDouble(portable::name));
  CONSTANT(THETA_LIMIT) CONSTANT(THETA_DOT_BOUND) CONSTANT(X_DOT_BOUND) CONSTANT(RATE_LIMIT) CONSTANT(MOTOR_WIDTH)
  CONSTANT(MOTOR_SLOPE) CONSTANT(ERROR_BOUND) CONSTANT(HOLD) CONSTANT(TOLERANCE) CONSTANT(TIME_TOLERANCE) CONSTANT(SPEED_BOUND)
  CONSTANT(SETTLING) CONSTANT(MEASURED)
#undef CONSTANT
  failed |= PyModule_AddIntConstant(module, "LANES", LANES);
  failed |= PyModule_AddIntConstant(module, "HISTORY_ROWS", HISTORY_ROWS);
  failed |= PyModule_AddIntConstant(module, "MOST_CELLS", MOST_CELLS);
  failed |= PyModule_AddIntConstant(module, "PADDING", portable::PADDING);
  failed |= PyModule_AddIntConstant(module, "CELLS", sizeof(portable::Identification) / sizeof(double));
  failed |= PyModule_AddIntConstant(module, "COMMANDS", portable::COMMANDS);
  return failed;
}

PyMethodDef METHODS[] = {
    {"bind", bind, METH_VARARGS, nullptr},
    {"advance", (PyCFunction)(void*)advance, METH_FASTCALL, nullptr},
    {"step_one", (PyCFunction)(void*)step_one, METH_FASTCALL, nullptr},
    {"draw_episodes", (PyCFunction)(void*)call_with_count<&Level::draw_episodes>, METH_FASTCALL, nullptr},
    {"begin_episodes", (PyCFunction)(void*)call_with_count<&Level::begin_episodes>, METH_FASTCALL, nullptr},
    {"evaluate", evaluate, METH_VARARGS, nullptr},
    {"law_torques", law_torques, METH_VARARGS, nullptr},
    {"platform_motion", platform_motion, METH_VARARGS, nullptr},
    {"act_batch", act_batch, METH_VARARGS, nullptr},
    {"run_episodes", run_episodes, METH_VARARGS, nullptr},
    {"write_inputs", write_inputs, METH_VARARGS, nullptr},
    {"plain_law", plain_law, METH_VARARGS, nullptr},
    {nullptr, nullptr, 0, nullptr}};
PyModuleDef_Slot SLOTS[] = {{Py_mod_exec, (void*)fill}, {0, nullptr}};
PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_core", nullptr, 0, METHODS, SLOTS, nullptr, nullptr, nullptr};

}  // namespace

PyMODINIT_FUNC PyInit__core() { return PyModuleDef_Init(&MODULE); }
