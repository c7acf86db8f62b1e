// A number type that records what is computed with it, from which Python writes the core's functions in other languages
// (capsule_gym/trace.py).
//
// A recording is a list of rows: an operation, and the places of its operands in the list. A branch, `when`, is always
// taken; assignments in it select between the new value and the old one.
#pragma once
#include "functions.hpp"
#include "network.hpp"
#include "step.hpp"

#define CAPSULE_OPERATIONS(OP)                                                                                       \
  OP(constant) OP(input) OP(output) OP(add) OP(subtract) OP(multiply) OP(divide) OP(negate) OP(fma) OP(absolute)     \
  OP(square_root) OP(copysign) OP(less) OP(less_equal) OP(equal) OP(both) OP(either) OP(inverse) OP(select)          \
  OP(power_of_two) OP(sincos) OP(sine) OP(cosine) OP(exp) OP(tanh)
constexpr int LONGEST_TRACE = 1 << 15;  // rows

namespace LEVEL {
enum class Operation {
#define OP(name) name,
  CAPSULE_OPERATIONS(OP)
#undef OP
};
struct TraceRow { double operation, a, b, c; };

inline struct {
  TraceRow* rows;
  int count;
  double taken;  // place of the condition of the present branch, or -1
} recording;

inline double record(Operation operation, double a = 0.0, double b = 0.0, double c = 0.0) {
  if (recording.count < LONGEST_TRACE) recording.rows[recording.count] = {(double)(int)operation, a, b, c};
  return recording.count++;
}

struct Condition {
  double place;
  friend Condition operator&(Condition a, Condition b) { return {record(Operation::both, a.place, b.place)}; }
  friend Condition operator|(Condition a, Condition b) { return {record(Operation::either, a.place, b.place)}; }
  friend Condition operator!(Condition a) { return {record(Operation::inverse, a.place)}; }
};

struct Trace {
  double place;
  Trace() = default;
  Trace(const Trace&) = default;
  Trace(double value) : place(record(Operation::constant, value)) {}
  static Trace of(Operation operation, double a = 0.0, double b = 0.0, double c = 0.0) {
    Trace result;
    result.place = record(operation, a, b, c);
    return result;
  }
  Trace& operator=(const Trace& value) {
    double taken = recording.taken;
    place = taken < 0.0 ? value.place : record(Operation::select, taken, value.place, place);
    return *this;
  }
  friend Trace operator+(Trace a, Trace b) { return of(Operation::add, a.place, b.place); }
  friend Trace operator-(Trace a, Trace b) { return of(Operation::subtract, a.place, b.place); }
  friend Trace operator*(Trace a, Trace b) { return of(Operation::multiply, a.place, b.place); }
  friend Trace operator/(Trace a, Trace b) { return of(Operation::divide, a.place, b.place); }
  friend Trace operator-(Trace a) { return of(Operation::negate, a.place); }
  friend Condition operator<(Trace a, Trace b) { return {record(Operation::less, a.place, b.place)}; }
  friend Condition operator>(Trace a, Trace b) { return b < a; }
  friend Condition operator<=(Trace a, Trace b) { return {record(Operation::less_equal, a.place, b.place)}; }
  friend Condition operator>=(Trace a, Trace b) { return b <= a; }
  friend Condition operator==(Trace a, Trace b) { return {record(Operation::equal, a.place, b.place)}; }
  friend Condition operator!=(Trace a, Trace b) { return !(a == b); }
};

struct Taken {
  double before = recording.taken;
  explicit Taken(Condition condition) {
    recording.taken = before < 0.0 ? condition.place : record(Operation::both, before, condition.place);
  }
  Taken(const Taken&) = delete;
  ~Taken() { recording.taken = before; }
  operator bool() const { return true; }
};
inline Taken when(Condition condition) { return Taken(condition); }

inline Trace select(Condition condition, Trace a, Trace b) {
  return Trace::of(Operation::select, condition.place, a.place, b.place);
}
inline Trace fma(Trace a, Trace b, Trace c) { return Trace::of(Operation::fma, a.place, b.place, c.place); }
inline Trace copysign(Trace size, Trace sign) { return Trace::of(Operation::copysign, size.place, sign.place); }
inline Trace abs(Trace x) { return Trace::of(Operation::absolute, x.place); }
inline Trace sqrt(Trace x) { return Trace::of(Operation::square_root, x.place); }
inline Trace power_of_two(Trace shifted) { return Trace::of(Operation::power_of_two, shifted.place); }
inline Trace exp(Trace x) { return Trace::of(Operation::exp, x.place); }
inline Trace tanh(Trace x) { return Trace::of(Operation::tanh, x.place); }
inline SinCos<Trace> sincos(Trace angle) {
  double both = record(Operation::sincos, angle.place);
  return {Trace::of(Operation::sine, both), Trace::of(Operation::cosine, both)};
}
CAPSULE_FUNCTIONS(Trace)

// A struct of inputs, and the output of a struct.
template <class S> S given() {
  S inputs;
  for (int i = 0; i < WIDTH<S>; i++) ((Trace*)&inputs)[i] = Trace::of(Operation::input);
  return inputs;
}
template <class S> void give(const S& outputs) {
  for (int i = 0; i < WIDTH<S>; i++) record(Operation::output, ((const Trace*)&outputs)[i].place);
}

// Records a function of a law or task with its number and of the constants, settings or the header of a network.
// Returns the number of rows.
inline int trace(const char* function, long long number, const double* constants, TraceRow* rows) {
  recording = {rows, 0, -1.0};
  auto is = [&](const char* name) { return !__builtin_strcmp(function, name); };
  const auto& settings = *(const Settings*)constants;
  const auto& header = *(const Header*)constants;
  const struct Pendulum { double m, l, g, dt; }& nominal = *(const Pendulum*)constants;
  struct Estimates { Trace values[4]; };
  if (is("sincos")) give(sincos<Trace>(given<Trace>()));
  if (is("exp")) give(exp<Trace>(given<Trace>()));
  if (is("tanh")) give(tanh<Trace>(given<Trace>()));
  if (is("action")) {
    Trace output = given<Trace>(), law_torque = given<Trace>();
    give(action_of(header, output, law_torque));
  }
  if (is("torque")) {
    Trace law_torque = given<Trace>(), action = given<Trace>();
    give(total_torque(settings, law_torque, action));
  }
  if (is("identify")) {
    auto filter = given<Filter<Trace>>();
    Trace theta = given<Trace>(), theta_dot = given<Trace>(), x_dot = given<Trace>();
    identify(filter, theta, theta_dot, x_dot, nominal);
    give(filter), give(deviation(filter.P_MM)), give(deviation(filter.P_ff));
  }
  int law = 0, task = 0;
#define LAW(Law)                                                                      \
  if (is("law") && number == law++) {                                                 \
    struct { Trace cells[Law::MEMORY]; } memory = given<decltype(memory)>();          \
    auto state = given<State<Trace>>();                                               \
    struct { Trace cells[Law::COLUMNS]; } row = given<decltype(row)>();               \
    give(Law(constants)(state, memory.cells, row.cells)), give(memory);               \
  }
  CAPSULE_LAWS(LAW)
#undef LAW
  // A task: its memory, x, and for an observation the x of the previous one and what is observed.
#define TASK(Task)                                                                                                    \
  if ((is("begin") || is("observe")) && number == task++) {                                                           \
    auto memory = given<Task::Memory<Trace>>();                                                                       \
    Trace x = given<Trace>();                                                                                         \
    if (is("begin")) Task::begin(x, memory);                                                                          \
    else {                                                                                                            \
      Trace before = given<Trace>();                                                                                  \
      auto begun = given<Trace>() != 0.0;                                                                             \
      auto seen = given<Observed<Trace>>();                                                                           \
      double dt = settings.law_steps * settings.physics_steps * settings.physics_dt;                                  \
      if (auto taken = when(begun)) Task::reward(x, seen.x_dot, x - before, dt, memory);                              \
      put_entries<Task>(settings, seen, memory, give<Trace>, [] { give(given<Estimates>()); });                                    \
    }                                                                                                                 \
    give(memory);                                                                                                     \
  }
  CAPSULE_TASKS(TASK)
#undef TASK
  return recording.count;
}
}  // namespace LEVEL
