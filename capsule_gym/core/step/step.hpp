// One agent step, from the action to the observation, of any number of environments: `Step::run` is
// its outline.
//
// The environments of a block are stepped together, as many at once as the number type holds. One
// in which an event happens (a change of the contact phase, the end of the episode) is left out of
// its substep and stepped by itself.
#pragma once
#include "../laws/laws.hpp"
#include "../physics/events.hpp"
#include "observation.hpp"
#include "sensing.hpp"

namespace LEVEL {
// |theta_dot| + |x_dot| (rad/s, m/s) after a substep with an event beyond which the motion counts
// as lost.
constexpr double RATE_LIMIT = 1e4;
// The cost of a step is 1 where less than this share of the weight presses on the floor, or of pi/2
// remains.
constexpr double MARGIN = 0.1;

// Whether the episode goes on and both are numbers. This check finds every step that overflows:
// within the limits of plant and torque, accelerations that overflow grow so fast from stage to
// stage that none cancels another in theta.
template <class T> INLINE auto continues(T theta, T normal_force) {
  return (abs(theta) < THETA_LIMIT) & (normal_force > 0.0);
}

// Whether the rates are those of a motion that the integrator resolves; false for NaN.
template <class T> INLINE auto bounded(T theta_dot, T x_dot) {
  return abs(theta_dot) + abs(x_dot) <= RATE_LIMIT;
}

// The torque in N m for an action in [-1, 1]: u = clip(law torque + residual).
template <class T> INLINE T total_torque(const Settings& settings, T law_torque, T action) {
  T residual;
  if (settings.total_torque != 0.0)
    residual = clip(settings.torque_limit * action - law_torque, T(settings.residual_limit));
  else residual = settings.residual_limit * action;
  return clip(law_torque + residual, T(settings.torque_limit));
}

// A block of N environments, of which n take part in loops, stepped with the number type T.
template <class T, int N> struct Step {
  const Batch& batch;
  const Settings& settings;
  Block<N>& b;
  const int n;
  const bool varied = settings.varied != 0.0;
  float* const observations;
  // The state that the law observes.
  const double* const seen;
  // Behind the rows of a block: the law's memory, its line of the reference, and the task's memory.
  // A varied plant has a second one with measured values; the first is the one that the law
  // observes.
  double* const memory;
  double* const line;
  double* const task;
  double* const read_task;
  Disturbed<T, N> disturbed;
  // Lanes with an event in the present substep.
  int events[N];
  int count = 0;

  Step(const Batch& batch, Block<N>& block, int n, float* observations)
      : batch(batch),
        settings(*batch.settings),
        b(block),
        n(n),
        observations(observations),
        seen(settings.law_reads != 0.0 ? FROM(read_theta) : FROM(theta)),
        memory(row(batch.layout->law_memory)),
        line(row(batch.layout->reference)),
        task(row(batch.layout->task)),
        read_task(row(batch.layout->read_task)),
        disturbed{settings, block, row(batch.layout->history), n} {}

  double* row(long long number) const { return (double*)&b + number * N; }

  // One agent step, or with `begin` the first call of the law in an episode.
  template <class Task> void run(bool begin) {
    if (begin && varied) disturbed.begin();
    if (!begin_step(begin) && begin) return;
    int ticks = begin ? 1 : (int)settings.law_steps;
    for (int tick = 0; tick < ticks; tick++) {
      if (!begin) hold_torque();
      // Law and agent observe a past state with sensor errors.
      if (varied) disturbed.measure(begin, tick + 1 == ticks);
      if (begin) start_task<Task>();
      call_law(begin ? 0.0 : 1.0);
    }
    if (!begin) finish_step<Task>();
    const double* observed_task = settings.agent_reads != 0.0 ? read_task : task;
    observe<Task>(batch, b, n, line, observed_task, row(batch.layout->estimator), observations,
                  begin);
  }

  // Clips the action; returns whether an environment takes part.
  NOINLINE bool begin_step(bool begin) {
    bool takes_part = false;
    EACH {
      auto active = GET(active) != 0.0;
      T m = varied ? GET(plant_m) : T(settings.m);
      PUT(halt, select(active, T(UNDER_WAY), T(HALTED)));
      PUT(action, clip(GET(action), T(1.0)));
      PUT(mass_ratio, m / (GET(M) + m));
      PUT(before_x, GET(x));
      if (varied) PUT(read_before_x, GET(read_x));
      PUT_WHERE(active, energy, 0.0);
      // The smallest of the step; at the start of an episode the weight, which `begin_episodes` has
      // written.
      if (!begin) PUT_WHERE(active, normal_force, INFINITE);
      takes_part |= any(active);
    }
    return takes_part;
  }

  void hold_torque() {
    if (varied) return hold_on<Kind::varied>();
    if (settings.extended != 0.0) return hold_on<Kind::extended>();
    hold_on<Kind::coulomb>();
  }

  // The torque is constant until the law is called again.
  template <Kind kind> NOINLINE void hold_on() {
    // A copy, which no write to the block can change: its quotients are computed once.
    const Settings kept = settings;
    double h = kept.physics_dt;
    for (int substep = 0; substep < (int)kept.physics_steps; substep++) {
      count = 0;
      EACH {
        if (substep == 0) apply_torque<kind>(j);
        // Where nothing sticks a third of the work is left out.
        if (any(GET(x_dot) == 0.0)) smooth_substep<kind, true>(j, h, kept);
        else smooth_substep<kind, false>(j, h, kept);
      }
      int left = count;
      if constexpr (N > 1)
        if (count > 1) left = pass_events<kind>(h);
      for (int e = 0; e < left; e++) step_with_events<kind>(events[e], h, (substep + 1) * h);
    }
  }

  template <Kind kind> INLINE void apply_torque(int j) {
    auto going = GET(halt) == UNDER_WAY;
    T torque = total_torque(settings, GET(law_torque), GET(action));
    if constexpr (Plant<T, kind>::varied) torque = disturbed.drive(j, torque, going);
    torque = select(going, torque, GET(torque));
    PUT(torque, torque);
    PUT(peak_torque, max(GET(peak_torque), abs(torque)));
    PUT(elapsed, T(disturbed.period()));
  }

  // The plants of the lanes of which `read` gives the numbers of a row.
  template <class P> INLINE P read_plant(const Settings& given, auto read) const {
    P p;
    p.M = read(b.M);
    p.mu = read(b.mu);
    p.mass_ratio = read(b.mass_ratio);
    p.pivot_torque_on_contact = given.pivot_torque_on_contact;
#define FIELD(name)                                       \
  if constexpr (P::varied) p.name = read(b.plant_##name); \
  else p.name = given.name;
    CAPSULE_PLANT(FIELD)
#undef FIELD
    return p;
  }

  // Takes the lanes from j on through one substep, unless it has an event: then they are listed.
  template <Kind kind, bool may_stick>
  INLINE void smooth_substep(int j, T h, const Settings& given) {
    auto p = read_plant<Plant<T, kind>>(given, [j](const double* row) { return load<T>(row + j); });
    auto s = load_record<State<T>, T, N>(FROM(theta), j);
    T torque = GET(torque);
    T slip = select(s.x_dot > 0.0, T(1.0), T(-1.0));
    if constexpr (may_stick) slip = p.contact_phase(s, torque);
    Stepped<T> r;
    auto lasts = smooth_step<may_stick>(s, slip, torque, p, h, r);
    auto going = GET(halt) == UNDER_WAY;
    auto smooth = lasts & continues(r.end.theta, r.first.normal);
    if (unsigned eventful = lanes(going & !smooth)) {
      for (; eventful; eventful &= eventful - 1) events[count++] = j + __builtin_ctz(eventful);
      store_record<T, N>(FROM(next_theta), j, r);
    }
    auto commit = going & smooth;
    T moved = select(commit, r.end.x - s.x, T(0.0));
    T turned = swept(s.theta_dot, r.end.theta_dot, r.end.theta - s.theta, h);
    State<T> end = {select(commit, r.end.theta, s.theta),
                    select(commit, r.end.theta_dot, s.theta_dot), select(commit, r.end.x, s.x),
                    select(commit, r.end.x_dot, s.x_dot)};
    add_motion<T, may_stick>(
        j, {.end = end,
            .forward = max(T(0.0), moved),
            .backward = max(T(0.0), -moved),
            .stuck = may_stick ? select(commit & (slip == 0.0), h, T(0.0)) : T(0.0),
            .swept = select(commit, turned, T(0.0)),
            .normal_force = select(commit, r.first.normal, T(INFINITE)),
            .events = 0.0});
  }

  // Writes the state at the end of a substep, and adds its contributions to the step and to the
  // episode.
  template <class S, bool may_stick = true> INLINE void add_motion(int j, const Motion<S>& m) {
    store_record<S, N>(FROM(theta), j, m.end);
    auto add = [j](double* row, S amount) { store(row + j, load<S>(row + j) + amount); };
    auto raise = [j](double* row, S number) { store(row + j, max(load<S>(row + j), number)); };
    add(b.energy, abs(load<S>(b.torque + j)) * m.swept);
    add(b.forward, m.forward);
    add(b.backward, m.backward);
    if constexpr (may_stick) add(b.stuck, m.stuck);
    store(b.normal_force + j, min(load<S>(b.normal_force + j), m.normal_force));
    raise(b.largest_theta, abs(m.end.theta));
    raise(b.largest_theta_dot, abs(m.end.theta_dot));
  }

  // Steps the environments that come to rest once in the substep, several at a time; returns how
  // many others are left.
  template <Kind kind> NOINLINE int pass_events(double h) {
    int left = 0;
    for (int first = 0; first < count; first += WIDTH<T>) {
      // Lanes behind the last environment repeat it, and are ignored.
      int many = count - first < WIDTH<T> ? count - first : WIDTH<T>;
      int lane[WIDTH<T>];
      for (int i = 0; i < WIDTH<T>; i++) lane[i] = events[first + (i < many ? i : many - 1)];
      auto at = [&lane](const double* row) { return gather(row, lane); };
      auto whole = read_record<Stepped<T>, N>(FROM(next_theta), at);
      Phase<Plant<T, kind>> start = {read_record<State<T>, N>(FROM(theta), at),
                                     sign_of(at(b.x_dot)), at(b.torque),
                                     read_plant<Plant<T, kind>>(settings, at), whole.first};
      auto [m, holds] = pass_rest(start, whole.end, T(h));
      auto resolved = bounded(m.end.theta_dot, m.end.x_dot) & (abs(m.end.x + m.swept) < INFINITE);
      holds = holds & continues(m.end.theta, m.normal_force) & resolved & (whole.smallest >= 0.0);
      unsigned passed = lanes(holds);
      for (int i = 0; i < many; i++) {
        if (passed >> i & 1) add_motion(lane[i], motion_of_lane(m, i));
        else events[left++] = lane[i];
      }
    }
    return left;
  }

  static INLINE Motion<double> motion_of_lane(const Motion<T>& m, int i) {
    Motion<double> own;
    for (int k = 0; k < WIDTH<Motion<double>>; k++)
      ((double*)&own)[k] = ((const double*)&m)[k * WIDTH<T> + i];
    return own;
  }

  // Steps one environment through a substep with any event.
  template <Kind kind> NOINLINE void step_with_events(int j, double h, double elapsed) {
    auto p = read_plant<Plant<double, kind>>(settings, [j](const double* row) { return row[j]; });
    auto s = load_record<State<double>, double, N>(FROM(theta), j);
    auto whole = load_record<Stepped<double>, double, N>(FROM(next_theta), j);
    double u = b.torque[j];
    Phase<Plant<double, kind>> start = {s, p.contact_phase(s, u), u, p, whole.first};
    auto m = event_step(start, whole.smallest >= 0.0 ? start.finish(h, whole) : start.piece(h));
    double sum = m.end.theta + m.end.x + m.swept + m.normal_force;
    bool resolved = bounded(m.end.theta_dot, m.end.x_dot) && abs(sum) < INFINITE;
    if (!resolved) {
      // The substep is discarded: the environment keeps the state at its start.
      auto a = p.accelerations(s.theta, s.theta_dot, s.x_dot, start.slip, u);
      b.normal_force[j] = min(b.normal_force[j], a.normal);
      return end_episode(j, DIVERGED, elapsed - h);
    }
    add_motion(j, m);
    if (abs(m.end.theta) >= THETA_LIMIT) end_episode(j, PENDULUM, elapsed);
    else if (m.normal_force <= 0.0) end_episode(j, CONTACT, elapsed);
  }

  INLINE void end_episode(int j, Termination reason, double elapsed) {
    b.termination[j] = reason;
    b.halt[j] = ENDING;
    b.elapsed[j] = elapsed;
  }

  NOINLINE void call_law(double tick) {
    // The only row of a reference stays where the first call has written it.
    if (batch.reference_rows > 1 || tick == 0.0) read_reference(tick);
    auto evaluate = [&]<class Law>() { evaluate_law(*(const Law*)batch.law_constants, tick); };
    if (!with_type(Laws(), batch.law, evaluate)) evaluate_user_law(tick);
  }

  // Writes the present lines of the reference, `tick` rows further on.
  INLINE void read_reference(double tick) {
    double cycle = (double)batch.reference_rows;
    long long size = batch.layout->reference_size();
    bool same = true;
    for (int j = 0; j < n; j++) {
      double clock = b.clock[j] + (b.halt[j] != HALTED ? tick : 0.0);
      b.clock[j] = clock < cycle ? clock : 0.0;
      same &= b.clock[j] == b.clock[0];
    }
    // Environments that began together read the same line.
    const double* first = batch.reference + (long long)b.clock[0] * size;
    for (long long r = 0; r < size; r++) {
      double* present = line + r * N;
      if (same) {
        EACH store(present + j, T(first[r]));
      } else {
        for (int j = 0; j < n; j++) present[j] = batch.reference[(long long)b.clock[j] * size + r];
      }
    }
  }

  // Calls the law with the present state; its torque acts until the next call.
  template <class Law> NOINLINE void evaluate_law(const Law& law, double tick) {
    using S = typename Law::template Number<T>;
    for (int j = 0; j < n; j += WIDTH<S>) {
      auto s = load_record<State<S>, S, N>(seen, j);
      auto cells = load_record<typename Law::template Cells<S>, S, N>(memory, j);
      // The task's memory follows the line.
      auto row = load_record<typename Law::template Line<S>, S, N>(line, j);
      S torque = law.torque(s, cells, row);
      store_record<S, N>(memory, j, cells, load<S>(b.halt + j) != HALTED);
      keep_torque(j, torque, tick);
    }
  }

  NOINLINE void evaluate_user_law(double tick) {
    long long size = batch.layout->memory_size() * N;
    // It writes the memory of every lane. Lanes that have halted get theirs back, and those whose
    // law has failed, so that it can be called again with the same arguments.
    double torques[N];
    double kept[MOST_CELLS * N];
    __builtin_memcpy(kept, memory, size * sizeof(double));
    EACH store(torques + j, T(__builtin_nan("")));
    batch.user_law(batch.user_data, (double*)&b, torques, n);
    EACH {
      T torque = load<T>(torques + j);
      auto keeps = (GET(halt) == HALTED) | !(abs(torque) < INFINITE);
      for (long long at = j; at < size; at += N)
        store<T>(memory + at, select(keeps, load<T>(kept + at), load<T>(memory + at)));
      keep_torque(j, torque, tick);
    }
  }

  template <class S> INLINE void keep_torque(int j, S torque, double tick) {
    auto get = [j](const double* row) { return load<S>(row + j); };
    S halt = get(b.halt);
    auto called = halt != HALTED;
    // Infinity must not pass for a clipped torque: infinity minus itself is NaN. The state stays as
    // the law saw it.
    S clipped = clip(torque, S(settings.torque_limit)) + (torque - torque);
    store<S>(b.law_torque + j, select(called, clipped, get(b.law_torque)));
    S elapsed = select(called, get(b.elapsed), S(0.0));
    S acted = get(b.torque);
    store<S>(b.duration + j, get(b.duration) + tick * elapsed);
    store<S>(b.torque_squared + j, get(b.torque_squared) + tick * elapsed * acted * acted);
    auto goes_on = (halt == UNDER_WAY) & (clipped == clipped);
    store<S>(b.halt + j, select(goes_on, S(UNDER_WAY), S(HALTED)));
  }

  template <class Task> NOINLINE void start_task() {
    EACH {
      auto begin = [&](double* memory, T observed_x) {
        auto m = load_record<typename Task::template Memory<T>, T, N>(task, j);
        Task::begin(GET(x), observed_x, m);
        store_record<T, N>(memory, j, m, GET(active) != 0.0);
      };
      if (varied) begin(read_task, GET(read_x));
      begin(task, GET(x));
    }
  }

  // Ends an agent step: rewards, the task's memory, and the sums of the episode.
  template <class Task> NOINLINE void finish_step() {
    EACH {
      auto active = GET(active) != 0.0;
      put_rewards(j, active, reward_task<Task>(j, active));
      add_step(j, active);
    }
  }

  // The task's reward; renews its memory.
  template <class Task> INLINE T reward_task(int j, auto active) {
    double dt = settings.control_dt();
    // Where the law has failed it can be called again with the same arguments.
    auto renews = active & (abs(GET(law_torque)) < INFINITE);
    auto renew = [&](double* rows, T x, T x_dot, T before_x, double rest) {
      auto m = load_record<typename Task::template Memory<T>, T, N>(rows, j);
      T gain = Task::reward(x, x_dot, x - before_x, dt, rest, m);
      store_record<T, N>(rows, j, m, renews);
      return gain;
    };
    T gain = renew(task, GET(x), GET(x_dot), GET(before_x), 0.0);
    if (varied)
      renew(read_task, GET(read_x), GET(read_x_dot), GET(read_before_x), settings.stick_threshold);
    return gain;
  }

  INLINE void put_rewards(int j, auto active, T progress) {
    T energy = -settings.energy_weight * GET(energy);
    T termination = select(GET(termination) != 0.0, T(-settings.termination_penalty), T(0.0));
    PUT(reward, select(active, progress + energy + termination, T(0.0)));
    PUT_WHERE(active, reward_progress, progress);
    PUT_WHERE(active, reward_energy, energy);
    PUT_WHERE(active, reward_termination, termination);
  }

  // Adds a step to the sums of the episode.
  INLINE void add_step(int j, auto active) {
    T share = select(active, T(1.0), T(0.0));
    T mass = GET(M) + (varied ? GET(plant_m) : T(settings.m));
    T g = varied ? GET(plant_g) : T(settings.g);
    T downhill = varied ? GET(plant_downhill) : T(settings.downhill);
    T gravity = sqrt(g * g + downhill * downhill);
    T moved = GET(x) - GET(before_x);
    PUT(steps, GET(steps) + share);
    PUT(episode_energy, GET(episode_energy) + share * GET(energy));
    PUT(weight_distance, GET(weight_distance) + share * (mass * gravity) * moved);
    T ratio = GET(normal_force) / (mass * g);
    PUT_WHERE(active, smallest_normal_ratio, min(GET(smallest_normal_ratio), ratio));
    auto lifts = ratio < MARGIN;
    auto falls = abs(GET(theta)) > (1.0 - MARGIN) * THETA_LIMIT;
    auto close = lifts | falls | (GET(termination) != 0.0);
    PUT_WHERE(active, cost, select(close, T(1.0), T(0.0)));
  }
};

// Applies the changes of M and mu that are due to the n environments from `first` on: at the first
// agent step that starts at or after their time. Begins with `change`, and returns the first one of
// later environments.
template <int N>
const Change* apply_changes(const Batch& batch, const Change* change, Block<N>& b, long long first,
                            int n) {
  const Change* end = batch.changes + batch.num_changes;
  double dt = batch.settings->control_dt();
  for (; change < end && change->environment < first + n; change++) {
    long long j = (long long)change->environment - first;
    if (j < 0 || b.active[j] == 0.0) continue;
    bool due = change->time <= b.steps[j] * dt + TIME_TOLERANCE;
    if (!due) continue;
    b.M[j] = change->M;
    b.mu[j] = change->mu;
  }
  return change;
}

// Steps the environments first..last-1, or begins their episodes; `first` is a multiple of N.
// Returns the index of an environment whose law returned a torque that is not finite, or -1.
template <class T, int N>
long long advance_blocks(const Batch& batch, long long first, long long last, bool begin) {
  long long broken = -1;
  const Change* change = batch.changes;
  for (long long at = first; at < last; at += N) {
    auto& b = block_of<N>(batch, at);
    int n = last - at < N ? (int)(last - at) : N;
    // Whole vectors: lanes behind the last environment are inactive.
    int width = (n + WIDTH<T> - 1) / WIDTH<T> * WIDTH<T>;
    for (int j = n; j < width; j++) b.active[j] = 0.0;
    if (!begin) change = apply_changes(batch, change, b, at, n);
    Step<T, N> step(batch, b, width, batch.observations + at * batch.layout->entries);
    with_type(Tasks(), batch.task, [&]<class Task>() { step.template run<Task>(begin); });
    for (int j = 0; j < n; j++)
      if (b.active[j] != 0.0 && !(abs(b.law_torque[j]) < INFINITE)) broken = at + j;
  }
  return broken;
}

inline long long advance(const Batch& batch, long long first, long long last, bool begin) {
#ifndef CAPSULE_ONE_ENVIRONMENT
  if (batch.lanes != 1) return advance_blocks<Pack, LANES>(batch, first, last, begin);
#endif
  return advance_blocks<double, 1>(batch, first, last, begin);
}

// A step of a single environment.
inline long long step_one(const Batch& batch, double action) {
  ((Block<1>*)batch.world)->action[0] = action;
  return advance(batch, 0, 1, false);
}
}  // namespace LEVEL
