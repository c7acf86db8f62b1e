// A trained policy in strict double precision: inputs, layers, at most one recurrent cell, action.
//
// Each unit adds its inputs in their order, bias first, by fused multiply-adds, so that an action
// depends only on its own observations, not on the batch or the instruction set. A register holds
// several units of one environment.
#pragma once
#include "numbers/elementary.hpp"

namespace LEVEL {
// The recurrent cell, by the number of its gates.
constexpr int GRU = 3;
constexpr int LSTM = 4;

struct Header {
  double layers;          // number of linear layers before the cell; 0 without a cell
  double head_layers;     // number of linear layers after the cell
  double relu;            // 1.0 if max(0, .) follows the hidden layers, 0.0 for tanh
  double tanh_squashing;  // 1.0 if tanh brings the last output to [-1, 1], 0.0 if it is clipped
  double clip;            // largest size of a normalised input
  double gates;           // GRU, LSTM, or 0.0 without a cell
  double units;           // of the cell
  double skip;  // 1.0 if the head also reads the normalised inputs, after the cell's output
};

// Units are padded to multiples of it: the numbers of the widest register.
constexpr int PADDING = 8;
// Environments for which a weight is read once.
constexpr int TOGETHER = 4;
constexpr int padded(int width) { return (width + PADDING - 1) / PADDING * PADDING; }
// Where the widths of a network begin.
constexpr int HEADER_SIZE = padded(WIDTH<Header>);

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

template <class T> INLINE T sigmoid(T x) { return 0.5 + 0.5 * tanh(0.5 * x); }

// A step of `torch.nn.GRU` for one environment: the gates r, z and n from sums over the inputs and
// over h, each of shape (3, units).
template <class T>
INLINE void step_gru(const double* from_inputs, const double* from_h, int units, double* h) {
  for (int k = 0; k < units; k += WIDTH<T>) {
    auto sum = [=](const double* sums, int gate) { return load<T>(sums + gate * units + k); };
    T r = sigmoid(sum(from_inputs, 0) + sum(from_h, 0));
    T z = sigmoid(sum(from_inputs, 1) + sum(from_h, 1));
    T n = tanh(sum(from_inputs, 2) + r * sum(from_h, 2));
    store(h + k, (1.0 - z) * n + z * load<T>(h + k));
  }
}

// A step of `torch.nn.LSTM` for one environment: the gates i, f, g and o from sums over the inputs
// and over h, each of shape (4, units).
template <class T>
INLINE void step_lstm(const double* from_inputs, const double* from_h, int units, double* h,
                      double* c) {
  for (int k = 0; k < units; k += WIDTH<T>) {
    auto sum = [=](int gate) {
      int place = gate * units + k;
      return load<T>(from_inputs + place) + load<T>(from_h + place);
    };
    T i = sigmoid(sum(0));
    T f = sigmoid(sum(1));
    T g = tanh(sum(2));
    T o = sigmoid(sum(3));
    T next = f * load<T>(c + k) + i * g;
    store(c + k, next);
    store(h + k, o * tanh(next));
  }
}

// The memory of an environment, in doubles: h, and for an LSTM c, each padded.
inline int memory_size(const Header& header) {
  int vectors = header.gates == LSTM ? 2 : header.gates == GRU ? 1 : 0;
  return vectors * padded((int)header.units);
}

// One control interval of several environments: a network with its present values.
//
// `network` is aligned to 64 bytes. Its parts follow each other, each padded with zeros to a
// multiple of PADDING: header, widths (inputs and the units of each linear layer), mean and scale
// of the inputs, and for each layer the biases and the weights, one row of padded units for each
// input. The cell has two layers, which read its inputs and h; each gate is padded by itself.
template <class T, int ENVIRONMENTS> struct Inference {
  const Header& header;
  const double* next;  // the part that is read next
  int width;           // doubles between two environments in `values` and `sums`
  double* values;
  double* sums;

  // The sums of the next layer over the values.
  INLINE void add(int inputs, int units, double* layer_sums) {
    Layer layer = {inputs, units, next, next + units};
    next += units + inputs * units;
    add_layer<T, ENVIRONMENTS>(layer, values, layer_sums, width);
  }

  // A linear layer and, unless it is the last one of the network, its activation.
  INLINE void apply_layer(int inputs, int units, bool hidden) {
    add(inputs, padded(units), sums);
    if (hidden)
      for (int r = 0; r < ENVIRONMENTS; r++)
        activate<T>(sums + r * width, padded(units), header.relu != 0.0);
    double* free = values;
    values = sums;
    sums = free;
  }

  // The cell, from the memory of the environments, of shape (ENVIRONMENTS, memory_size).
  INLINE void apply_cell(int inputs, double* from_h, double* memory) {
    const int units = padded((int)header.units);
    const int size = memory_size(header);
    const int gates = (int)header.gates;
    add(inputs, gates * units, sums);
    for (int r = 0; r < ENVIRONMENTS; r++)
      for (int k = 0; k < units; k++) values[r * width + k] = memory[r * size + k];
    add((int)header.units, gates * units, from_h);
    for (int r = 0; r < ENVIRONMENTS; r++) {
      double* h = memory + r * size;
      int start = r * width;
      if (gates == GRU) step_gru<T>(sums + start, from_h + start, units, h);
      else step_lstm<T>(sums + start, from_h + start, units, h, h + units);
      for (int k = 0; k < units; k++) values[start + k] = h[k];
    }
  }
};

// The actions in [-1, 1] for observations of shape (ENVIRONMENTS, inputs); renews the memory of a
// recurrent network.
template <class T, int ENVIRONMENTS>
NOINLINE void act_together(const double* network, const float* observations, double* memory,
                           float* actions) {
  const Header& header = *(const Header*)network;
  const int layers = (int)header.layers;
  const int head_layers = (int)header.head_layers;
  const bool recurrent = header.gates != 0.0;
  const double* widths = network + HEADER_SIZE;
  const int inputs = (int)widths[0];
  const double* mean = widths + padded(layers + head_layers + 1);
  const double* scale = mean + padded(inputs);
  int width = (int)header.gates * padded((int)header.units);
  auto widen = [&](int least) { width = least > width ? least : width; };
  widen(padded((int)header.units + inputs));
  for (int i = 0; i <= layers + head_layers; i++) widen(padded((int)widths[i]));
  const int size = ENVIRONMENTS * width;
  // A wide load that crosses a cache line takes twice as long.
  const int buffers = recurrent ? 3 : 2;
  double* values = (double*)__builtin_alloca_with_align(buffers * size * sizeof(double), 512);
  Inference<T, ENVIRONMENTS> inference = {header, scale + padded(inputs), width, values,
                                          values + size};
  auto normalise = [&](double* to) {
    for (int r = 0; r < ENVIRONMENTS; r++)
      for (int i = 0; i < inputs; i++) {
        double input = (observations[r * inputs + i] - mean[i]) * scale[i];
        to[r * width + i] = clip(input, header.clip);
      }
  };
  normalise(inference.values);
  int before = inputs;  // the width of the last values
  int n = 1;
  for (; n <= layers; n++) {
    inference.apply_layer(before, (int)widths[n], true);
    before = (int)widths[n];
  }
  if (recurrent) {
    inference.apply_cell(before, values + 2 * size, memory);
    before = (int)header.units;
    if (header.skip != 0.0) {
      normalise(inference.values + before);
      before += inputs;
    }
  }
  for (; n <= layers + head_layers; n++) {
    inference.apply_layer(before, (int)widths[n], n < layers + head_layers);
    before = (int)widths[n];
  }
  for (int r = 0; r < ENVIRONMENTS; r++) {
    double found = inference.values[r * width];
    actions[r] = (float)clip(header.tanh_squashing != 0.0 ? tanh(found) : found, 1.0);
  }
}

// The same for any number of environments.
inline void act(const double* network, const float* observations, double* memory, long long n,
                float* actions) {
  const long long inputs = (long long)network[HEADER_SIZE];
  const long long size = memory_size(*(const Header*)network);
  long long i = 0;
  for (; i + TOGETHER <= n; i += TOGETHER)
    act_together<Pack, TOGETHER>(network, observations + i * inputs, memory + i * size,
                                 actions + i);
  for (; i < n; i++)
    act_together<Pack, 1>(network, observations + i * inputs, memory + i * size, actions + i);
}
}  // namespace LEVEL
