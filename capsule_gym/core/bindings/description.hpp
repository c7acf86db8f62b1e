// What Python and JavaScript learn from the core: lists of names, the metrics of a task, and as
// plain arrays what follows from the options of an environment.
#pragma once
#include "../step/contract.hpp"

namespace LEVEL {
// A list and the names in it, which spaces separate.
struct NameList {
  const char *list, *names;
};

constexpr const char* OPTION_NAMES =
    CAPSULE_OPTIONS(CAPSULE_NAME, CAPSULE_RANGE_NAMES, CAPSULE_DISTURBANCE_NAMES);
#define ROW CAPSULE_NAME
#define FIELD(type, name) CAPSULE_NAME(name)
constexpr NameList NAME_LISTS[] = {
    {"ROW_NAMES", CAPSULE_ROWS},
    {"OPTIONS", OPTION_NAMES},
    {"BATCH", CAPSULE_BATCH(FIELD)},
    {"CONSTANTS", CAPSULE_CONSTANTS(CAPSULE_NAME)},
    {"DISTURBANCES", CAPSULE_DISTURBANCES(CAPSULE_NAME)},
    {"SAMPLING", CAPSULE_SAMPLING(CAPSULE_NAME)},
    {"TERMINATIONS", CAPSULE_TERMINATIONS},
};
#undef FIELD
#undef ROW

// Puts the metrics of an episode of the task, each as put(name, description): first those that all
// tasks share.
template <class Task, class Put> void describe_metrics(Put put) {
  // An environment of zeros.
  struct {
    Block<1> block;
    typename Task::template Memory<double> memory;
    double end;
  } world = {};
  Layout layout = {};
  layout.rows = layout.task = NUM_ROWS;
  Batch batch = {};
  batch.world = (double*)&world;
  batch.layout = &layout;
  batch.lanes = 1;
  auto put_names = [&](const char* name, const char* description, double) {
    put(name, description);
  };
  put_metrics<Task, 1>(batch, 0, 0.0, put_names);
}

// The task's range of an environment that leaves it to the task.
constexpr Range NOT_GIVEN = {__builtin_nan(""), __builtin_nan("")};

// An entry of the observation: its name, its age in agent steps, and its bounds.
struct Entry {
  const char* name;
  double age, low, high;
};

// What follows from the options of an environment, with arrays of `layout.entries` and
// `layout.draws`.
struct Description {
  Settings settings;
  Layout layout;
  Entry* entries;
  Draw* draws;
};

// Describes an environment; returns false if there is no such task. `allocate` returns the address
// of a number of bytes, at `entries`, which the caller frees; or a null, which ends the
// description.
template <class Allocate>
bool describe_environment(const Options& o, Description& d, Allocate allocate) {
  d = {};
  d.settings = make_settings(o);
  return with_type(Tasks(), (long long)o.task, [&]<class Task>() {
    d.layout = make_layout<Task>(o, d.settings);
    d.entries = (Entry*)allocate(d.layout.entries * sizeof(Entry) + d.layout.draws * sizeof(Draw));
    if (!d.entries) return;
    Entry* next = d.entries;
    describe_entries<Task>(d.settings, [&](const char* name, int age, double low, double high) {
      *next++ = {name, (double)age, low, high};
    });
    d.draws = (Draw*)next;
    make_draws<Task>(o, d.settings, d.layout, d.draws);
  });
}
}  // namespace LEVEL
