// A trained policy in strict double precision, for up to LANES environments at once: inputs, layers, action.
//
// Each unit adds its inputs in their order, bias first, by fused multiply-adds, so that an action depends only on its
// own observation, not on the batch or the instruction set. A register holds one unit of several environments or, where
// there are few, several units of one environment.
#pragma once
#include "identification.hpp"
#include "layout.hpp"

// The header of a network, SI units; conditions are 0.0 or 1.0.
#define CAPSULE_NETWORK(FIELD)                                                                                         \
  /* Number of layers; whether max(0, .) follows the hidden layers, else tanh; whether tanh brings the last output to  \
     [-1, 1], else it is clipped; largest size of a normalised input. */                                               \
  FIELD(layers) FIELD(relu) FIELD(tanh_squashing) FIELD(clip)                                                          \
  /* Number of inputs, and of those that are the environment's observation; whether the estimates of M and mu follow   \
     the observation. */                                                                                               \
  FIELD(inputs) FIELD(observed) FIELD(identifies)                                                                      \
  /* Ball, pendulum and gravitational acceleration that the filter of M and mu assumes; time between two actions. */   \
  FIELD(m) FIELD(l) FIELD(g) FIELD(dt)

namespace LEVEL {
struct Header { CAPSULE_NETWORK(CAPSULE_DOUBLE) };

constexpr int PADDING = 8;  // units and environments are padded to multiples of it: the numbers of the widest register
constexpr int padded(int width) { return (width + PADDING - 1) / PADDING * PADDING; }

// A packed network, aligned to 64 bytes. Its parts follow each other, each padded with zeros to a multiple of PADDING:
// header, widths (inputs and the units of each layer), mean and scale of the inputs, and for each layer the biases and
// the weights, one row of padded units for each input.
struct Network {
  const Header& header;
  const double *widths, *mean, *scale, *layers;
  int widest = 0;  // padded

  explicit Network(const double* packed)
      : header(*(const Header*)packed),
        widths(packed + padded(sizeof(Header) / sizeof(double))),
        mean(widths + padded((int)header.layers + 1)),
        scale(mean + padded((int)header.inputs)),
        layers(scale + padded((int)header.inputs)) {
    for (int i = 0; i <= header.layers; i++)
      if (int width = padded((int)widths[i]); width > widest) widest = width;
  }
};

struct Layer {
  int inputs, outputs, units;  // units: outputs, padded
  const double *bias, *weights;
};

// Adds to ROWS rows of PACKS registers of sums, for each input, the products of ROWS scalars and PACKS registers. The
// scalars of the next input lie `scalar_step` further, its registers, and the next row of sums, `vector_step`.
template <class T, int ROWS, int PACKS>
INLINE void add_products(int inputs, const double* scalars, int scalar_step, const double* vectors, int vector_step,
                         double* sums) {
  T s[ROWS][PACKS];
  for (int r = 0; r < ROWS; r++)
    for (int p = 0; p < PACKS; p++) s[r][p] = load<T>(sums + r * vector_step + p * WIDTH<T>);
  for (int i = 0; i < inputs; i++, scalars += scalar_step, vectors += vector_step) {
    T v[PACKS];
    for (int p = 0; p < PACKS; p++) v[p] = load<T>(vectors + p * WIDTH<T>);
    for (int r = 0; r < ROWS; r++)
      for (int p = 0; p < PACKS; p++) s[r][p] = fma(T(scalars[r]), v[p], s[r][p]);
  }
  for (int r = 0; r < ROWS; r++)
    for (int p = 0; p < PACKS; p++) store(sums + r * vector_step + p * WIDTH<T>, s[r][p]);
}

// The sums of all units of a layer for 1 environment or a multiple of PADDING, `rows`; the values of an input, and the
// sums of a unit, lie side by side.
template <class T> NOINLINE void affine(const Layer& layer, const double* values, int rows, double* sums) {
  const int inputs = layer.inputs, outputs = layer.outputs, units = layer.units;
  const double *bias = layer.bias, *weights = layer.weights;
  // Registers of PADDING numbers, and as many as can be added to at once.
  constexpr int NARROW = PADDING / WIDTH<T>, WIDE = NARROW == 1 ? 4 : NARROW;
  if (rows == 1) {
    __builtin_memcpy(sums, bias, units * sizeof(double));
    int k = 0;
    for (; k + 8 * WIDTH<T> <= units; k += 8 * WIDTH<T>)
      add_products<T, 1, 8>(inputs, values, 1, weights + k, units, sums + k);
    for (; k < units; k += PADDING) add_products<T, 1, NARROW>(inputs, values, 1, weights + k, units, sums + k);
    return;
  }
  for (int k = 0; k < outputs; k++)
    for (int j = 0; j < rows; j++) sums[k * rows + j] = bias[k];
  auto add = [&]<int PACKS>(int j) {
    int k = 0;
    for (; k + 4 <= outputs; k += 4)
      add_products<T, 4, PACKS>(inputs, weights + k, units, values + j, rows, sums + k * rows + j);
    for (; k < outputs; k++)
      add_products<T, 1, PACKS>(inputs, weights + k, units, values + j, rows, sums + k * rows + j);
  };
  int j = 0;
  for (; j + WIDE * WIDTH<T> <= rows; j += WIDE * WIDTH<T>) add.template operator()<WIDE>(j);
  for (; j < rows; j += PADDING) add.template operator()<NARROW>(j);
}

// Applies the activation; NaN stays NaN.
template <class T> NOINLINE void activate(double* sums, int count, bool relu) {
  for (int j = 0; j < count; j += WIDTH<T>) {
    T total = load<T>(sums + j);
    store(sums + j, relu ? select(total < 0.0, T(0.0), total) : tanh(total));
  }
}

// The outputs for inputs of shape (n, inputs), of one environment or of at least PADDING.
template <class T>
inline const double* forward(const Network& network, const float* inputs, int n, double* values, double* sums) {
  const Header& header = network.header;
  int rows = n == 1 ? 1 : padded(n);
  double size = header.clip;
  for (int i = 0; i < header.inputs; i++) {
    double *row = values + i * rows, mean = network.mean[i], scale = network.scale[i];
    for (int j = 0; j < rows; j++) row[j] = j < n ? inputs[j * (int)header.inputs + i] : 0.0;
    for (int j = 0; j < rows; j++) row[j] = clip((row[j] - mean) * scale, size);
  }
  const double* next = network.layers;
  for (int i = 0; i < header.layers; i++) {
    Layer layer = {(int)network.widths[i], (int)network.widths[i + 1], padded((int)network.widths[i + 1]), next, next};
    layer.weights += layer.units;
    next = layer.weights + layer.inputs * layer.units;
    affine<T>(layer, values, rows, sums);
    if (i < header.layers - 1) activate<T>(sums, n == 1 ? layer.units : layer.outputs * rows, header.relu != 0.0);
    double* other = values;
    values = sums, sums = other;
  }
  if (header.tanh_squashing != 0.0) activate<T>(values, n == 1 ? PADDING : rows, false);
  return values;
}

// Writes the network's inputs of n environments, shape (n, inputs): the observation, shape (n, entries), and what the
// policy adds to it. `memory`, of n environments, is changed, and not read without identification.
inline void write_inputs(const Header& header, const float* observations, long long entries, long long n,
                         Identification* memory, float* inputs) {
  for (long long i = 0; i < n; i++) {
    const float* observed = observations + i * entries;
    for (int k = 0; k < header.observed; k++) *inputs++ = observed[k];
    if (header.identifies != 0.0) {
      identify<double>(memory[i], observed[0], observed[1], observed[2], header);
      inputs = write_estimates(memory[i], inputs);
    }
  }
}

// Bytes of the working memory of `act` for n environments.
inline long long workspace_size(const Network& network, int n) {
  return 64 + (16LL * network.widest + 4 * (long long)network.header.inputs) * padded(n);
}

// The actions in [-1, 1] of n <= LANES environments from `first` on. The observations, shape (.., entries), and the
// memory are those of all environments.
template <class T = Pack>
inline void act(const Network& network, const float* observations, long long entries, long long first, int n,
                Identification* memory, void* workspace, double* actions) {
  const Header& header = network.header;
  // A wide load that crosses a cache line takes twice as long.
  double* values = (double*)(((Word)workspace + 63) & ~63ULL);
  double* sums = values + network.widest * padded(n);
  float* inputs = (float*)(sums + network.widest * padded(n));
  write_inputs(header, observations + first * entries, entries, n, memory + first, inputs);
  // A few environments one after the other, in registers of units.
  int together = n < PADDING ? 1 : n;
  for (int j = 0; j < n; j += together) {
    const double* outputs = forward<T>(network, inputs + j * (int)header.inputs, together, values, sums);
    for (int i = j; i < j + together; i++) actions[i] = clip(outputs[i - j], 1.0);
  }
}

// The actions of any number of environments, as `act`; -1, or NO_MEMORY.
inline long long act_batch(const double* packed, const float* observations, long long entries, long long n,
                           Identification* memory, float* actions) {
  Network network(packed);
  void* workspace = __builtin_malloc(workspace_size(network, n < LANES ? (int)n : LANES));
  if (!workspace) return NO_MEMORY;
  for (long long first = 0; first < n; first += LANES) {
    double found[LANES];
    int count = n - first < LANES ? (int)(n - first) : LANES;
    act(network, observations, entries, first, count, memory, workspace, found);
    for (int j = 0; j < count; j++) actions[first + j] = (float)found[j];
  }
  __builtin_free(workspace);
  return -1;
}
}  // namespace LEVEL
