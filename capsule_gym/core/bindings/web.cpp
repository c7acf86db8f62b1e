// The core for browsers and node, compiled to WebAssembly: one environment, without Python and
// without packs. Every environment has an instance of the module with a memory of its own.
#define LEVEL web
#define CAPSULE_ONE_ENVIRONMENT
#include "../network.hpp"
#include "../step/resets.hpp"
#include "../step/step.hpp"
#include "description.hpp"

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

static Batch batch;
static web::Options options;
static web::Description description;
// JavaScript reads the arrays of a description by these sizes.
static_assert(sizeof(web::Entry) == 32 && sizeof(Draw) == 48);

// The address of new memory, zeros, which is never freed: whole pages. It invalidates JavaScript's
// views of the memory.
EXPORT(allocate) unsigned long allocate(unsigned long bytes) {
  constexpr unsigned long PAGE = 65536;
  return __builtin_wasm_memory_grow(0, (bytes + PAGE - 1) / PAGE) * PAGE;
}

// --- the contract ---

// The address of a table of lists and their names, which a null ends; a list may have several
// lines. From each line "TASK" on, the lists are those of the task.
EXPORT(name_lists) const web::NameList* name_lists() {
  static web::NameList table[1024];
  web::NameList* next = table;
  auto put = [&](const char* list, const char* names) { *next++ = {list, names}; };
  for (auto [list, names] : web::NAME_LISTS) put(list, names);
  put("SETTINGS", CAPSULE_SETTINGS(CAPSULE_NAME));
  put("LAYOUT", CAPSULE_LAYOUT(CAPSULE_NAME));
  // In the order of their numbers.
  [&]<class... Law>(web::List<Law...>) { (put("LAWS", Law::NAME), ...); }(web::Laws());
  auto put_task = [&]<class Task>() {
    put("TASK", Task::NAME);
    put("fields", Task::FIELDS);
    put("shown", Task::SHOWN);
    put("draws", "");
    Task::draws(web::NOT_GIVEN,
                [&](const char* option, double, double, double) { put("draws", option); });
    web::describe_metrics<Task>([&](const char* name, const char*) { put("metrics", name); });
  };
  [&]<class... Task>(web::List<Task...>) {
    (put_task.template operator()<Task>(), ...);
  }(web::Tasks());
  return table;
}

// The address of the options, which JavaScript writes in the order of their names.
EXPORT(options) web::Options* options_address() { return &options; }

// Describes an environment with these options; returns the address of the description, which the
// next call replaces.
EXPORT(describe) const web::Description* describe() {
  static unsigned long room = 0, size = 0;
  web::describe_environment(options, description, [](unsigned long bytes) {
    if (bytes > size) {
      room = allocate(bytes);
      size = bytes;
    }
    return room;
  });
  return &description;
}

// --- an episode ---

// Sets the fields of `Batch` in their order, arrays by their addresses, and those that are part of
// the description.
EXPORT(bind) void bind(const double* fields) {
#define FIELD(type, name) batch.name = (type)(long)*fields++;
  CAPSULE_BATCH(FIELD)
#undef FIELD
  batch.settings = &description.settings;
  batch.layout = &description.layout;
  batch.draw_table = description.draws;
}

EXPORT(draw_episode) void draw_episode() { web::draw_episodes(batch, 1); }
EXPORT(begin_episode) void begin_episode() { web::begin_episodes<1>(batch, 1); }

// One agent step, or with `begin` the first call of the law in an episode; false if the law's
// torque is not finite.
EXPORT(advance) bool advance(bool begin) { return web::advance(batch, 0, 1, begin) < 0; }

// Writes the metrics of the episode so far in the order of their names; `horizon`: length of a
// whole episode, s.
EXPORT(metrics) void metrics(double horizon, double* out) {
  web::episode_metrics<1>(batch, batch.rows, 1, horizon, out);
}

// The length of the memory of a policy with this cell, or of none.
EXPORT(memory_size) int memory_size(double gates, double units) {
  return web::memory_size({.gates = gates, .units = units});
}

// The cosine of an angle in rad, with the bits of Python's.
EXPORT(cosine) double cosine(double angle) { return web::sincos(angle).cos; }

// The action of a trained policy for the observation; renews the memory of a recurrent one, which
// is zeros at the start of an episode.
EXPORT(act) double act(const double* network, double* memory) {
  float action;
  web::act_together<double, 1>(network, batch.observations, memory, &action);
  return action;
}
