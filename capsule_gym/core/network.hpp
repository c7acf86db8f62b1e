// A trained policy in strict double precision: inputs, layers, action.
//
// Each unit adds its inputs in their order, bias first, by fused multiply-adds, so that an action
// depends only on its own observation, not on the batch or the instruction set. A register holds
// several units of one environment.
#pragma once
#include "numbers/elementary.hpp"

namespace LEVEL {
struct Header {
  double layers;          // their number
  double relu;            // 1.0 if max(0, .) follows the hidden layers, 0.0 for tanh
  double tanh_squashing;  // 1.0 if tanh brings the last output to [-1, 1], 0.0 if it is clipped
  double clip;            // largest size of a normalised input
};

// Units are padded to multiples of it: the numbers of the widest register.
constexpr int PADDING = 8;
// Environments for which a weight is read once.
constexpr int TOGETHER = 4;
constexpr int padded(int width) { return (width + PADDING - 1) / PADDING * PADDING; }

struct Layer {
  int inputs;
  int units;  // padded
  const double* bias;
  const double* weights;
};

// The sums of PACKS registers of units, from unit k on, for several environments. The numbers of
// the next environment lie `width` further.
template <class T, int ENVIRONMENTS, int PACKS>
INLINE void add_inputs(const Layer& layer, int k, const double* values, double* sums, int width) {
  T s[ENVIRONMENTS][PACKS];
  for (int r = 0; r < ENVIRONMENTS; r++)
    for (int p = 0; p < PACKS; p++) s[r][p] = load<T>(layer.bias + k + p * WIDTH<T>);
  const double* weights = layer.weights + k;
  for (int i = 0; i < layer.inputs; i++, weights += layer.units) {
    T w[PACKS];
    for (int p = 0; p < PACKS; p++) w[p] = load<T>(weights + p * WIDTH<T>);
    for (int r = 0; r < ENVIRONMENTS; r++)
      for (int p = 0; p < PACKS; p++) s[r][p] = fma(T(values[r * width + i]), w[p], s[r][p]);
  }
  for (int r = 0; r < ENVIRONMENTS; r++)
    for (int p = 0; p < PACKS; p++) store(sums + r * width + k + p * WIDTH<T>, s[r][p]);
}

// The sums of all units, as many registers at once as can be added to; the rest by PADDING units.
template <class T, int ENVIRONMENTS>
INLINE void add_layer(const Layer& layer, const double* values, double* sums, int width) {
  constexpr int NARROW = PADDING / WIDTH<T>;
  constexpr int BATCHED = NARROW == 1 ? 4 : NARROW;
  constexpr int WIDE = ENVIRONMENTS == 1 ? 8 : BATCHED;
  int k = 0;
  for (; k + WIDE * WIDTH<T> <= layer.units; k += WIDE * WIDTH<T>)
    add_inputs<T, ENVIRONMENTS, WIDE>(layer, k, values, sums, width);
  for (; k < layer.units; k += PADDING)
    add_inputs<T, ENVIRONMENTS, NARROW>(layer, k, values, sums, width);
}

// Applies the activation; NaN stays NaN.
template <class T> INLINE void activate(double* sums, int count, bool relu) {
  for (int k = 0; k < count; k += WIDTH<T>) {
    T total = load<T>(sums + k);
    store(sums + k, relu ? select(total < 0.0, T(0.0), total) : tanh(total));
  }
}

// The actions in [-1, 1] for observations of shape (ENVIRONMENTS, inputs).
//
// `network` is aligned to 64 bytes. Its parts follow each other, each padded with zeros to a
// multiple of PADDING: header, widths (inputs and the units of each layer), mean and scale of the
// inputs, and for each layer the biases and the weights, one row of padded units for each input.
template <class T, int ENVIRONMENTS>
NOINLINE void act_together(const double* network, const float* observations, float* actions) {
  const Header& header = *(const Header*)network;
  const double* widths = network + padded(WIDTH<Header>);
  const int inputs = (int)widths[0];
  const int layers = (int)header.layers;
  const double* mean = widths + padded(layers + 1);
  const double* scale = mean + padded(inputs);
  const double* next = scale + padded(inputs);
  int width = 0;  // largest number of inputs or units, padded
  for (int i = 0; i <= layers; i++)
    width = padded((int)widths[i]) > width ? padded((int)widths[i]) : width;
  // A wide load that crosses a cache line takes twice as long.
  double* values =
      (double*)__builtin_alloca_with_align(2 * ENVIRONMENTS * width * sizeof(double), 512);
  double* sums = values + ENVIRONMENTS * width;
  for (int r = 0; r < ENVIRONMENTS; r++)
    for (int i = 0; i < inputs; i++) {
      double input = (observations[r * inputs + i] - mean[i]) * scale[i];
      values[r * width + i] = clip(input, header.clip);
    }
  for (int n = 0; n < layers; n++) {
    Layer layer = {(int)widths[n], padded((int)widths[n + 1]), next, next};
    layer.weights += layer.units;
    next = layer.weights + layer.inputs * layer.units;
    add_layer<T, ENVIRONMENTS>(layer, values, sums, width);
    bool hidden = n < layers - 1;
    if (hidden)
      for (int r = 0; r < ENVIRONMENTS; r++)
        activate<T>(sums + r * width, layer.units, header.relu != 0.0);
    double* free = values;
    values = sums;
    sums = free;
  }
  for (int r = 0; r < ENVIRONMENTS; r++) {
    double found = values[r * width];
    actions[r] = (float)clip(header.tanh_squashing != 0.0 ? tanh(found) : found, 1.0);
  }
}

// The same for any number of environments.
inline void act(const double* network, const float* observations, long long n, float* actions) {
  const long long inputs = (long long)network[padded(WIDTH<Header>)];
  long long i = 0;
  for (; i + TOGETHER <= n; i += TOGETHER)
    act_together<Pack, TOGETHER>(network, observations + i * inputs, actions + i);
  for (; i < n; i++) act_together<Pack, 1>(network, observations + i * inputs, actions + i);
}
}  // namespace LEVEL
