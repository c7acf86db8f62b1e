// The speed task's step with direct torque in plain C, to compare the core with what a compiler
// makes of plain loops. The equations, the integrator, the location of events, sums and rewards are
// those of `capsule_gym/core`, which explains the symbols; the rounding is the compiler's.
// benchmarks/throughput.py compiles it with -ffast-math.
#include <math.h>

// Environments in a block, and those of them that are stepped together: where none sticks, the
// margin of stick is left out.
#define N 128
#define CHUNK 8
#define SUBSTEPS 10
#define LARGE 1e300
#define THETA_LIMIT 1.5707963267948966
#define EVENT_TOLERANCE 1e-15
#define LAST_CORRECTION 1e-6
#define SMALLEST_BRACKET 1e-14
#define VOID_PHASE 1e-9
#define ROOT_ITERATIONS 60
#define EVENT_LIMIT 1000
#define RATE_LIMIT 1e4
#define MARGIN 0.1
// A call in a loop would keep it from being vectorised.
#define INLINE static inline __attribute__((always_inline))

typedef struct {
  double m, l, g, k, c, static_ratio, backward_ratio;
} Pendulum;
typedef struct {
  Pendulum pendulum;
  double torque_limit, dt, energy_weight, termination_penalty, stick_threshold;
} Settings;

// The first rows are the core's.
typedef struct {
  double theta[N], theta_dot[N], x[N], x_dot[N], M[N], mu[N];
  double torque[N], law_torque[N], normal_force[N], energy[N];
  double reward_progress[N], reward_energy[N], reward_termination[N], cost[N], reward[N];
  double termination[N], steps[N], start_x[N], duration[N];
  double episode_energy[N], weight_distance[N], torque_squared[N], peak_torque[N];
  double forward[N], backward[N], stuck[N];
  double smallest_normal_ratio[N], largest_theta[N], largest_theta_dot[N];
  double slip[N], mass_ratio[N], before_x[N], event[N], halted[N], elapsed[N];
} Block;
const int ROWS = sizeof(Block) / sizeof(double) / N;

typedef struct {
  double theta, theta_dot, x, x_dot;
} State;
typedef struct {
  double theta, x, normal;
} Accelerations;
// The plant and its phase of contact.
typedef struct {
  double M, mu, mass_ratio, slip, u;
  Pendulum pendulum;
} Phase;
// What stays positive while the phase lasts.
typedef struct {
  double value, rate;
} Boundary;

INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE double clip(double value, double limit) { return smaller(limit, larger(-limit, value)); }
INLINE double kinetic(double slip, Phase p) {
  return slip < 0.0 ? p.mu * p.pendulum.backward_ratio : p.mu;
}

// libm's functions take longer.
INLINE void sine_cosine(double angle, double* sine, double* cosine) {
  double y = 0.5 * (angle - 6.283185307179586 * rint(angle * 0.15915494309189535));
  double z = y * y;
  double zz = z * z;
  double s = (2.731428986122616e-15 * z - 7.643969031052769e-13) * zz + 1.6058977272815506e-10 * z -
             2.50521076163846e-08;
  double c = (4.777877290768691e-14 - 1.521855926409455e-16 * z) * zz + 2.087675660256890e-09 -
             1.1470712252875163e-11 * z;
  s = s * zz * zz + (2.755731921915843e-06 * z - 0.00019841269841254955) * zz +
      0.008333333333333316 * z - 1.0 / 6.0;
  c = c * zz * zz + (2.4801587301579844e-05 - 2.7557319221567154e-07 * z) * zz + 1.0 / 24.0 -
      0.001388888888888888 * z;
  s = y + y * z * s;
  c = 1.0 - 0.5 * z + zz * c;
  *sine = 2.0 * s * c;
  *cosine = 1.0 - 2.0 * s * s;
}

INLINE double stick_acceleration(double theta, double theta_dot, double sine, Phase p) {
  Pendulum q = p.pendulum;
  double torque = p.u - q.k * theta - q.c * theta_dot;
  return q.g / q.l * sine + torque * (1.0 / (q.m * q.l * q.l));
}

// Eq. (1) with the friction slip mu N; N is not clamped.
INLINE Accelerations accelerate(double theta, double theta_dot, double mu, Phase p) {
  double m = p.pendulum.m, l = p.pendulum.l, g = p.pendulum.g;
  double sine, cosine;
  sine_cosine(theta, &sine, &cosine);
  double share = p.slip * p.slip * p.mass_ratio;
  double rough = p.slip * mu;
  double squared = theta_dot * theta_dot;
  double tilted = cosine + rough * sine;
  double rest = share * l * (rough * cosine - sine) * squared - rough * g;
  double free = stick_acceleration(theta, theta_dot, sine, p);
  double a = (free + cosine * (1.0 / l) * rest) / (1.0 - share * cosine * tilted);
  double normal = (p.M + m) * g - m * l * (squared * cosine + a * sine);
  return (Accelerations){a, rest + share * l * tilted * a, normal};
}

// Static friction limit minus load of a platform at rest, and the load.
INLINE double stick_margin(double theta, double w, Phase p, double* rate, double* load) {
  Pendulum q = p.pendulum;
  double ml = q.m * q.l;
  double sine, cosine;
  sine_cosine(theta, &sine, &cosine);
  double a = stick_acceleration(theta, w, sine, p);
  *load = ml * (cosine * a - sine * w * w);
  double rough = q.static_ratio * kinetic(*load, p);
  double limit = rough * larger(0.0, (p.M + q.m) * q.g - ml * (a * sine + w * w * cosine));
  double jerk = (ml * q.g * cosine * w - q.k * w - q.c * a) / (ml * q.l);
  double load_rate = ml * (cosine * jerk - 3.0 * sine * w * a - cosine * w * w * w);
  double limit_rate = -rough * ml * (sine * jerk + 3.0 * cosine * w * a - sine * w * w * w);
  *rate = *load > 0.0 ? limit_rate - load_rate : limit_rate + load_rate;
  return limit - fabs(*load);
}

INLINE double sign_of(double direction) { return direction > 0.0 ? 1.0 : -1.0; }

INLINE double contact_phase(State s, Phase p) {
  double rate, load;
  double margin = stick_margin(s.theta, s.theta_dot, p, &rate, &load);
  double rests = margin >= 0.0 ? 0.0 : sign_of(load);
  double backward = s.x_dot < 0.0 ? -1.0 : rests;
  return s.x_dot > 0.0 ? 1.0 : backward;
}

// A Runge-Kutta step in one phase from the accelerations a: the state at its end, and the smallest
// N of its stages.
INLINE State runge_kutta(State s, Accelerations a, double mu, Phase p, double h, double* smallest) {
  double half = 0.5 * h;
  double sixth = h / 6.0;
  double theta_2 = s.theta + half * s.theta_dot;
  Accelerations b = accelerate(theta_2, s.theta_dot + half * a.theta, mu, p);
  double theta_3 = theta_2 + half * half * a.theta;
  Accelerations c = accelerate(theta_3, s.theta_dot + half * b.theta, mu, p);
  double theta_4 = s.theta + h * s.theta_dot + half * h * b.theta;
  Accelerations d = accelerate(theta_4, s.theta_dot + h * c.theta, mu, p);
  *smallest = smaller(smaller(a.normal, b.normal), smaller(c.normal, d.normal));
  return (State){s.theta + h * s.theta_dot + h * sixth * (a.theta + b.theta + c.theta),
                 s.theta_dot + sixth * (a.theta + 2.0 * (b.theta + c.theta) + d.theta),
                 s.x + h * s.x_dot + h * sixth * (a.x + b.x + c.x),
                 s.x_dot + sixth * (a.x + 2.0 * (b.x + c.x) + d.x)};
}

INLINE int crosses(Boundary before, double after, double h) {
  return (after < 0.0) | ((before.value > 0.0) & (before.value + h * before.rate < 0.0));
}

INLINE State state_of(const Block* b, int j) {
  return (State){b->theta[j], b->theta_dot[j], b->x[j], b->x_dot[j]};
}
INLINE Phase phase_of(const Block* b, Settings settings, int j) {
  return (Phase){b->M[j], b->mu[j], b->mass_ratio[j], b->slip[j], b->torque[j], settings.pendulum};
}

// Adds the contributions of h seconds in one phase, where `counts` is 1.
INLINE void add_motion(Block* b, int j, State s, State e, double h, double counts, double slip) {
  double start = s.theta_dot;
  double end = e.theta_dot;
  double moved = counts * (e.x - s.x);
  double both = 0.5 * h * (start * start + end * end) / (fabs(start) + fabs(end) + 1.0 / LARGE);
  double swept = start * end >= 0.0 ? fabs(e.theta - s.theta) : both;
  b->energy[j] += counts * fabs(b->torque[j]) * swept;
  b->forward[j] += larger(0.0, moved);
  b->backward[j] += larger(0.0, -moved);
  b->stuck[j] += slip == 0.0 ? counts * h : 0.0;
}

INLINE void write_state(Block* b, int j, State s, double normal) {
  b->theta[j] = s.theta;
  b->theta_dot[j] = s.theta_dot;
  b->x[j] = s.x;
  b->x_dot[j] = s.x_dot;
  b->normal_force[j] = smaller(b->normal_force[j], normal);
  b->largest_theta[j] = larger(b->largest_theta[j], fabs(s.theta));
  b->largest_theta_dot[j] = larger(b->largest_theta_dot[j], fabs(s.theta_dot));
}

// One substep of a chunk. An environment with an event keeps its state and is marked.
INLINE void smooth_substep(Block* b, Settings settings, int first, double h, int may_stick) {
  for (int j = first; j < first + CHUNK; j++) {
    Phase p = phase_of(b, settings, j);
    State s = state_of(b, j);
    double mu = kinetic(p.slip, p);
    double smallest;
    Accelerations a = accelerate(s.theta, s.theta_dot, mu, p);
    State e = runge_kutta(s, a, mu, p, h, &smallest);
    Boundary before = {p.slip * s.x_dot, p.slip * a.x};
    double after = p.slip * e.x_dot;
    if (may_stick) {
      double rate, rate_after, load;
      double margin = stick_margin(s.theta, s.theta_dot, p, &rate, &load);
      double margin_after = stick_margin(e.theta, e.theta_dot, p, &rate_after, &load);
      before.value = p.slip == 0.0 ? margin : before.value;
      before.rate = p.slip == 0.0 ? rate : before.rate;
      after = p.slip == 0.0 ? margin_after : after;
    }
    int stopped = (p.slip != 0.0) & (e.x_dot == 0.0);
    int event = crosses(before, after, h) | stopped | (smallest < 0.0);
    int ends = event | (fabs(e.theta) >= THETA_LIMIT);
    double going = 1.0 - b->halted[j];
    double counts = ends ? 0.0 : going;
    b->event[j] = going - counts;
    add_motion(b, j, s, e, h, counts, p.slip);
    State kept = {counts != 0.0 ? e.theta : s.theta, counts != 0.0 ? e.theta_dot : s.theta_dot,
                  counts != 0.0 ? e.x : s.x, counts != 0.0 ? e.x_dot : s.x_dot};
    write_state(b, j, kept, counts != 0.0 ? a.normal : LARGE);
  }
}

// The start of a phase with its accelerations; and a part of a substep in it, of tau seconds.
typedef struct {
  State s;
  Accelerations first;
  Phase p;
} Start;
typedef struct {
  double tau, normal;
  State end;
  Accelerations last;
  Boundary boundary;
} Piece;

static Boundary boundary(State s, double x_ddot, const Phase* p) {
  if (p->slip != 0.0) return (Boundary){p->slip * s.x_dot, p->slip * x_ddot};
  double rate, load;
  double margin = stick_margin(s.theta, s.theta_dot, *p, &rate, &load);
  return (Boundary){margin, rate};
}

static Piece take(const Start* at, double tau) {
  double mu = kinetic(at->p.slip, at->p);
  double normal = at->first.normal;
  double smallest;
  State end = runge_kutta(at->s, at->first, mu, at->p, tau, &smallest);
  int lost = smallest < 0.0;
  if (lost) {  // the contact: without friction
    mu = 0.0;
    Accelerations free = accelerate(at->s.theta, at->s.theta_dot, mu, at->p);
    end = runge_kutta(at->s, free, mu, at->p, tau, &smallest);
    normal = free.normal;
  }
  Accelerations last = accelerate(end.theta, end.theta_dot, mu, at->p);
  return (Piece){tau, larger(0.0, normal), end, last, boundary(end, last.x, &at->p)};
}

// The share of the root in a bracket of `width` seconds, of the cubic through its ends.
static double first_guess(Boundary before, Boundary after, double width) {
  double c = before.rate * width;
  double d = 3.0 * (after.value - before.value) - 2.0 * c - after.rate * width;
  double e = 2.0 * (before.value - after.value) + c + after.rate * width;
  double share = before.value / (before.value - after.value);
  for (int i = 0; i < 3; i++) {
    double slope = (3.0 * e * share + 2.0 * d) * share + c;
    double value = ((e * share + d) * share + c) * share + before.value;
    if (slope < 0.0) share = smaller(1.0, larger(0.0, share - value / slope));
  }
  return share;
}

// The piece that ends on the boundary: Newton's method in a bracket that begins at `low`.
static Piece locate(const Start* at, double low, Boundary before, Piece r) {
  double high = r.tau;
  double width = high - low;
  double tau = low + first_guess(before, r.boundary, width) * width;
  double step = LARGE;
  for (int i = 0; i < ROOT_ITERATIONS; i++) {
    r = take(at, tau);
    double value = r.boundary.value;
    step = r.boundary.rate < 0.0 ? -value / r.boundary.rate : LARGE;
    int small = fabs(step) <= LAST_CORRECTION * width;
    int narrow = high - low <= SMALLEST_BRACKET * width;
    if (small || narrow || fabs(value) <= EVENT_TOLERANCE) break;
    *(value < 0.0 ? &high : &low) = tau;
    tau += step;
    if (!(low < tau && tau < high)) tau = 0.5 * (low + high);
  }
  if (fabs(step) > LAST_CORRECTION * width) return r;
  r.tau += step;
  r.end.theta += step * r.end.theta_dot;
  r.end.x += step * r.end.x_dot;
  r.end.theta_dot += step * r.last.theta;
  r.end.x_dot += step * r.last.x;
  return r;
}

static Piece until_event(const Start* at, Boundary before, Piece whole) {
  Piece beyond = whole;
  if (whole.boundary.value >= 0.0) {
    // The minimum of the parabola with this start, rate and end.
    double h = whole.tau;
    double curvature = whole.boundary.value - before.value - before.rate * h;
    double dip = curvature > 0.0 ? -0.5 * before.rate * h * h / curvature : h;
    if (dip >= h) return whole;
    beyond = take(at, dip);
    if (beyond.boundary.value >= 0.0) return whole;
  }
  if (before.value > EVENT_TOLERANCE) return locate(at, 0.0, before, beyond);
  // The phase starts on its boundary.
  for (int i = 0; i < ROOT_ITERATIONS; i++) {
    Piece left = take(at, 0.5 * beyond.tau);
    if (left.boundary.value > 0.0) return locate(at, left.tau, left.boundary, beyond);
    beyond = left;
  }
  return beyond;
}

static double termination(State s, double normal) {
  if (fabs(s.theta) >= THETA_LIMIT) return 1.0;
  if (normal <= 0.0) return 2.0;
  return fabs(s.theta_dot) + fabs(s.x_dot) <= RATE_LIMIT ? 0.0 : 3.0;
}

// A substep of one environment through every change of phase.
static void step_with_events(Block* b, Settings settings, int j, double h, double elapsed) {
  Start at = {.s = state_of(b, j), .p = phase_of(b, settings, j)};
  double left = h;
  double normal = LARGE;
  double rate, load;
  for (int count = 1; count <= EVENT_LIMIT && left > 0.0; count++) {
    at.first = accelerate(at.s.theta, at.s.theta_dot, kinetic(at.p.slip, at.p), at.p);
    Piece r = take(&at, left);
    Boundary before = boundary(at.s, at.first.x, &at.p);
    int crossed = crosses(before, r.boundary.value, left) && count < EVENT_LIMIT;
    int beyond = crossed && r.boundary.value < 0.0;
    if (crossed) r = until_event(&at, before, r);
    add_motion(b, j, at.s, r.end, r.tau, 1.0, at.p.slip);
    normal = smaller(normal, r.normal);
    at.s = r.end;
    if (!(r.tau < left || beyond)) break;
    left -= r.tau;
    if (at.p.slip == 0.0) {
      stick_margin(at.s.theta, at.s.theta_dot, at.p, &rate, &load);
      at.p.slip = sign_of(load);
    } else {
      at.s.x_dot = 0.0;
      int returned = before.value <= 0.0 && r.tau <= VOID_PHASE * h;
      at.p.slip = returned ? 0.0 : contact_phase(at.s, at.p);
    }
  }
  write_state(b, j, at.s, normal);
  b->slip[j] = contact_phase(at.s, at.p);
  double reason = termination(at.s, normal);
  if (reason == 0.0) return;
  b->termination[j] = reason;
  b->halted[j] = 1.0;
  b->elapsed[j] = elapsed;
  b->slip[j] = 1.0;
}

INLINE void begin_step(Block* b, Settings settings, const double* actions) {
  double m = settings.pendulum.m;
  for (int j = 0; j < N; j++) {
    b->torque[j] = settings.torque_limit * clip(actions[j], 1.0);
    b->mass_ratio[j] = m / (b->M[j] + m);
    b->peak_torque[j] = larger(b->peak_torque[j], fabs(b->torque[j]));
    b->before_x[j] = b->x[j];
    b->energy[j] = 0.0;
    b->halted[j] = 0.0;
    b->normal_force[j] = LARGE;
    b->elapsed[j] = SUBSTEPS * settings.dt;
    b->slip[j] = contact_phase(state_of(b, j), phase_of(b, settings, j));
  }
}

INLINE void finish_step(Block* b, Settings settings) {
  double penalty = -settings.termination_penalty;
  for (int j = 0; j < N; j++) {
    double moved = b->x[j] - b->before_x[j];
    double weight = (b->M[j] + settings.pendulum.m) * settings.pendulum.g;
    b->reward_progress[j] = 100.0 * moved;
    b->reward_energy[j] = -settings.energy_weight * b->energy[j];
    b->reward_termination[j] = b->termination[j] != 0.0 ? penalty : 0.0;
    b->reward[j] = b->reward_progress[j] + b->reward_energy[j] + b->reward_termination[j];
    b->steps[j] += 1.0;
    b->episode_energy[j] += b->energy[j];
    b->weight_distance[j] += weight * moved;
    b->duration[j] += b->elapsed[j];
    b->torque_squared[j] += b->elapsed[j] * b->torque[j] * b->torque[j];
    double ratio = b->normal_force[j] / weight;
    b->smallest_normal_ratio[j] = smaller(b->smallest_normal_ratio[j], ratio);
    int falls = fabs(b->theta[j]) > (1.0 - MARGIN) * THETA_LIMIT;
    int close = (ratio < MARGIN) | falls | (b->termination[j] != 0.0);
    b->cost[j] = close ? 1.0 : 0.0;
  }
}

INLINE void observe(const Block* b, Settings settings, const double* actions, float* observations) {
  for (int j = 0; j < N; j++) {
    float* o = observations + 5 * j;
    o[0] = (float)clip(b->theta[j], THETA_LIMIT);
    o[1] = (float)clip(b->theta_dot[j], 20.0);
    o[2] = (float)clip(b->x_dot[j], 2.0);
    o[3] = fabs(b->x_dot[j]) <= settings.stick_threshold ? 1.0f : 0.0f;
    o[4] = (float)clip(actions[j], 1.0);
  }
}

INLINE void step_chunk(Block* b, Settings settings, int first) {
  int sticks = 0;
  for (int j = first; j < first + CHUNK; j++) sticks |= b->slip[j] == 0.0;
  if (sticks)
    smooth_substep(b, settings, first, settings.dt, 1);
  else
    smooth_substep(b, settings, first, settings.dt, 0);
}

void step(Block* blocks, int num_blocks, const Settings* given, const double* actions,
          float* observations) {
  // A copy: a load behind a condition would keep a loop from being vectorised.
  Settings settings = *given;
  for (int i = 0; i < num_blocks; i++) {
    Block* b = blocks + i;
    begin_step(b, settings, actions + i * N);
    for (int substep = 1; substep <= SUBSTEPS; substep++) {
      for (int first = 0; first < N; first += CHUNK) step_chunk(b, settings, first);
      for (int j = 0; j < N; j++)
        if (b->event[j] != 0.0)
          step_with_events(b, settings, j, settings.dt, substep * settings.dt);
    }
    finish_step(b, settings);
    observe(b, settings, actions + i * N, observations + 5 * i * N);
  }
}
