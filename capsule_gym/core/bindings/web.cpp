// The core for browsers and node, compiled to WebAssembly: one environment, without Python and without packs. Every
// environment has an instance of the module with a memory of its own.
#define LEVEL web
#define CAPSULE_ONE_ENVIRONMENT
#include "../network.hpp"
#include "../step/resets.hpp"
#include "../step/step.hpp"

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

static Batch batch;

// The address of new memory, zeros, which is never freed: whole pages. It invalidates JavaScript's views of the memory.
EXPORT(allocate) unsigned long allocate(unsigned long bytes) {
  constexpr unsigned long PAGE = 65536;
  return __builtin_wasm_memory_grow(0, (bytes + PAGE - 1) / PAGE) * PAGE;
}

// Sets the fields of `Batch` in their order; arrays by their addresses.
EXPORT(bind) void bind(const double* fields) {
#define FIELD(type, name) batch.name = (type)(long)*fields++;
  CAPSULE_BATCH(FIELD)
#undef FIELD
}

EXPORT(draw_episode) void draw_episode() { web::draw_episodes(batch, 1); }
EXPORT(begin_episode) void begin_episode() { web::begin_episodes<1>(batch, 1); }

// One agent step, or with `begin` the first call of the law in an episode; false if the law's torque is not finite.
EXPORT(advance) bool advance(bool begin) { return web::advance(batch, 0, 1, begin) < 0; }

// The action of a trained policy for the observation.
EXPORT(act) double act(const double* network) {
  float action;
  web::act_together<double, 1>(network, batch.observations, &action);
  return action;
}
