// The functions that Python evaluates, on any numbers: no crash. Networks that `Policy` accepts:
// their actions and memories stay within their limits, together and alone.
#include <cstring>
#include <vector>

#include "../../capsule_gym/core/bindings/level.cpp"
#include "input.hpp"

using namespace fuzz;

namespace {
#define CHECK(condition) \
  if (!(condition)) __builtin_trap()

std::vector<double> any_numbers(Input& in, size_t count) {
  std::vector<double> numbers;
  bool moderate = in.flag();
  for (size_t n = 0; n < count; n++)
    numbers.push_back(moderate ? in.number(1.0, -1e3, 1e3) : in.any());
  return numbers;
}

void evaluate_function(Input& in) {
  constexpr int COUNT = sizeof FUNCTIONS / sizeof *FUNCTIONS;
  const Function& function = FUNCTIONS[in.whole(0, COUNT - 1)];
  if (function.numbers == 0) return;
  long long n = in.whole(1, 3);
  auto rows = any_numbers(in, n * function.numbers);
  std::vector<double> results(n * MOST_RESULTS);
  auto plant = any_numbers(in, WIDTH<AnyPlant>);
  Argument arguments[] = {{(long long)rows.data()},
                          {function.numbers},
                          {(long long)results.data()},
                          {n},
                          {(long long)plant.data()}};
  CHECK(function.invoke(arguments) <= MOST_RESULTS);
}

void take_trajectory(Input& in) {
  constexpr int SIZE = WIDTH<TrajectoryInputs<double>>;
  long long n = in.whole(1, 4), steps = in.whole(1, 4);
  auto values = any_numbers(in, SIZE + n);
  auto partials = any_numbers(in, (SIZE + n) * DIRECTIONS);
  double h = in.number(1e-3, 1e-9, 1e6);
  std::vector<double> states(5 * (n + 1)), same(5 * (n + 1)), slopes(4 * DIRECTIONS * (n + 1));
  trajectory<double>(values.data(), nullptr, n, steps, h, states.data(), nullptr);
  trajectory<Dual>(values.data(), partials.data(), n, steps, h, same.data(), slopes.data());
  for (size_t i = 0; i < states.size(); i++)
    CHECK(states[i] == same[i] || (states[i] != states[i] && same[i] != same[i]));
}

// A weight as a policy file holds it.
double weight(Input& in) {
  constexpr double LARGEST_FLOAT = __FLT_MAX__;
  return (float)in.number(0.3, -LARGEST_FLOAT, LARGEST_FLOAT);
}

struct Network {
  std::vector<double> numbers;

  void pad() { numbers.resize(padded((int)numbers.size())); }

  // Biases and weights as `_pack_layer` of capsule_gym/policies/network.py packs them.
  void add_layer(Input& in, int inputs, int units, int gates = 1) {
    for (int row = 0; row <= inputs; row++)
      for (int gate = 0; gate < gates; gate++) {
        for (int k = 0; k < units; k++) numbers.push_back(weight(in));
        pad();
      }
  }
};

void use_network(Input& in) {
  constexpr double LARGEST_CLIP = 1e6;
  int gates = in.whole(0, 2) ? in.whole(GRU, LSTM) : 0;
  int units = gates ? in.whole(1, 10) : 0;
  int layers = gates ? in.whole(0, 2) : 0;
  int head = in.whole(1, 3);
  bool skip = gates && in.flag();
  double clip = in.number(10.0, 5e-324, LARGEST_CLIP);
  std::vector<int> widths;
  for (int n = 0; n <= layers + head; n++) widths.push_back(in.whole(1, 10));
  widths.back() = 1;
  Network net;
  net.numbers = {(double)layers, (double)head,  (double)in.flag(), (double)in.flag(),
                 clip,           (double)gates, (double)units,     (double)skip};
  net.pad();
  for (int width : widths) net.numbers.push_back(width);
  net.pad();
  int inputs = widths[0];
  for (int i = 0; i < inputs; i++) net.numbers.push_back(in.number(0.0, -8e307, 8e307));
  net.pad();
  for (int i = 0; i < inputs; i++) net.numbers.push_back(in.number(1.0, 1e-154, 1e150));
  net.pad();
  for (int n = 0; n < layers; n++) net.add_layer(in, widths[n], widths[n + 1]);
  int before = widths[layers];
  if (gates) {
    net.add_layer(in, before, units, gates);
    net.add_layer(in, units, units, gates);
    before = units + (skip ? inputs : 0);
  }
  for (int n = layers; n < layers + head; n++) {
    net.add_layer(in, before, widths[n + 1]);
    before = widths[n + 1];
  }

  const double* network = net.numbers.data();
  int size = memory_size(*(const Header*)network);
  int n = in.whole(1, 6);
  std::vector<double> together(n * size), alone(n * size);
  for (int i = 0; i < n; i++)
    for (int k = 0; k < size; k++)
      together[i * size + k] = alone[i * size + k] =
          k % padded(units) < units && in.flag() ? in.number(0.5, -1e9, 1e9) : 0.0;
  std::vector<float> observations(n * inputs), actions(n), action(1);
  for (int step = 0; step < 3; step++) {
    for (float& each : observations) each = (float)weight(in);
    act(network, observations.data(), together.data(), n, actions.data());
    for (int i = 0; i < n; i++) {
      act(network, observations.data() + i * inputs, alone.data() + i * size, 1, action.data());
      CHECK(std::fabs(actions[i]) <= 1.0f && actions[i] == action[0]);
    }
    for (double cell : together) CHECK(std::isfinite(cell));
    CHECK(together == alone);
  }
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  Input in = {{data, size}};
  switch (in.whole(0, 2)) {
    case 0:
      evaluate_function(in);
      break;
    case 1:
      take_trajectory(in);
      break;
    default:
      use_network(in);
  }
  return 0;
}
