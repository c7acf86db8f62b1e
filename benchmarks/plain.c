// The speed task's step with direct torque in plain C, to compare the core with what a compiler
// makes of plain loops. The equations, the integrator, the location of events, sums and rewards are
// those of `capsule_gym/core`, which explains the symbols; the rounding is the compiler's.
// benchmarks/throughput.py compiles it with -ffast-math.
#include <math.h>

#define N 128    // environments in a block
#define CHUNK 8  // of them, stepped together: where none sticks, the margin of stick is left out
#define SUBSTEPS 10
#define LARGE 1e300
#define THETA_LIMIT 1.5707963267948966
#define EVENT_TOLERANCE 1e-15
#define LAST_CORRECTION 1e-6
// A call in a loop would keep it from being vectorised.
#define INLINE static inline __attribute__((always_inline))

typedef struct {
  double m, l, g, k, c, static_ratio, backward_ratio;
  double torque_limit, dt, energy_weight, termination_penalty, stick_threshold;
} Settings;

// The first rows are the core's.
typedef struct {
  double theta[N], theta_dot[N], x[N], x_dot[N], M[N], mu[N], torque[N], law_torque[N],
      normal_force[N], energy[N];
  double reward_progress[N], reward_energy[N], reward_termination[N], cost[N], reward[N],
      termination[N], steps[N];
  double start_x[N], duration[N], episode_energy[N], weight_distance[N], torque_squared[N],
      peak_torque[N];
  double forward[N], backward[N], stuck[N], smallest_normal_ratio[N], largest_theta[N],
      largest_theta_dot[N];
  double slip[N], mass_ratio[N], before_x[N], event[N], halted[N], elapsed[N];
} Block;
const int ROWS = sizeof(Block) / sizeof(double) / N;

typedef struct {
  double theta, theta_dot, x, x_dot;
} State;
typedef struct {
  double theta, x, normal;
} Accelerations;
typedef struct {
  double M, mu, mass_ratio, slip, u;
  Settings q;
} Phase;  // the plant and its phase of contact

INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE double clip(double value, double limit) { return smaller(limit, larger(-limit, value)); }
INLINE double kinetic(double slip, Phase p) {
  return slip < 0.0 ? p.mu * p.q.backward_ratio : p.mu;
}

// libm's functions take longer.
INLINE void sine_cosine(double angle, double* sine, double* cosine) {
  double y = 0.5 * (angle - 6.283185307179586 * rint(angle * 0.15915494309189535)), z = y * y,
         zz = z * z;
  double s = (2.731428986122616e-15 * z - 7.643969031052769e-13) * zz + 1.6058977272815506e-10 * z -
             2.50521076163846e-08;
  double c = (4.777877290768691e-14 - 1.521855926409455e-16 * z) * zz + 2.087675660256890e-09 -
             1.1470712252875163e-11 * z;
  s = s * zz * zz + (2.755731921915843e-06 * z - 0.00019841269841254955) * zz +
      0.008333333333333316 * z - 1.0 / 6.0;
  c = c * zz * zz + (2.4801587301579844e-05 - 2.7557319221567154e-07 * z) * zz + 1.0 / 24.0 -
      0.001388888888888888 * z;
  s = y + y * z * s, c = 1.0 - 0.5 * z + zz * c;
  *sine = 2.0 * s * c, *cosine = 1.0 - 2.0 * s * s;
}

INLINE double stick_acceleration(double theta, double theta_dot, double sine, Phase p) {
  return p.q.g / p.q.l * sine +
         (p.u - p.q.k * theta - p.q.c * theta_dot) * (1.0 / (p.q.m * p.q.l * p.q.l));
}

// Eq. (1) with the friction slip mu N; N is not clamped.
INLINE Accelerations accelerate(double theta, double theta_dot, double mu, Phase p) {
  double l = p.q.l, share = p.slip * p.slip * p.mass_ratio, rough = p.slip * mu, sine, cosine;
  sine_cosine(theta, &sine, &cosine);
  double squared = theta_dot * theta_dot, tilted = cosine + rough * sine;
  double rest = share * l * (rough * cosine - sine) * squared - rough * p.q.g;
  double free = stick_acceleration(theta, theta_dot, sine, p);
  double a = (free + cosine * (1.0 / l) * rest) / (1.0 - share * cosine * tilted);
  double normal = (p.M + p.q.m) * p.q.g - p.q.m * l * (squared * cosine + a * sine);
  return (Accelerations){a, rest + share * l * tilted * a, normal};
}

// Static friction limit minus load of a platform at rest, its rate, and the load.
INLINE double stick_margin(double theta, double w, Phase p, double* rate, double* force) {
  double sine, cosine, ml = p.q.m * p.q.l, g = p.q.g;
  sine_cosine(theta, &sine, &cosine);
  double a = stick_acceleration(theta, w, sine, p), load = ml * (cosine * a - sine * w * w);
  double rough = p.q.static_ratio * kinetic(load, p);
  double limit = rough * larger(0.0, (p.M + p.q.m) * g - ml * (a * sine + w * w * cosine));
  double jerk = (ml * g * cosine * w - p.q.k * w - p.q.c * a) / (ml * p.q.l);
  double load_rate = ml * (cosine * jerk - 3.0 * sine * w * a - cosine * w * w * w);
  double limit_rate = -rough * ml * (sine * jerk + 3.0 * cosine * w * a - sine * w * w * w);
  *rate = load > 0.0 ? limit_rate - load_rate : limit_rate + load_rate, *force = load;
  return limit - fabs(load);
}

INLINE double contact_phase(State s, Phase p) {
  double rate, force, margin = stick_margin(s.theta, s.theta_dot, p, &rate, &force);
  double rests = margin >= 0.0 ? 0.0 : force > 0.0 ? 1.0 : -1.0;
  return s.x_dot > 0.0 ? 1.0 : s.x_dot < 0.0 ? -1.0 : rests;
}

// A Runge-Kutta step in one phase from the accelerations a: the state at its end, and the smallest
// N of its stages.
INLINE State runge_kutta(State s, Accelerations a, double mu, Phase p, double h, double* smallest) {
  double half = 0.5 * h, sixth = h / 6.0, theta_2 = s.theta + half * s.theta_dot;
  Accelerations b = accelerate(theta_2, s.theta_dot + half * a.theta, mu, p);
  Accelerations c =
      accelerate(theta_2 + half * half * a.theta, s.theta_dot + half * b.theta, mu, p);
  Accelerations d =
      accelerate(s.theta + h * s.theta_dot + half * h * b.theta, s.theta_dot + h * c.theta, mu, p);
  *smallest = smaller(smaller(a.normal, b.normal), smaller(c.normal, d.normal));
  return (State){s.theta + h * s.theta_dot + h * sixth * (a.theta + b.theta + c.theta),
                 s.theta_dot + sixth * (a.theta + 2.0 * (b.theta + c.theta) + d.theta),
                 s.x + h * s.x_dot + h * sixth * (a.x + b.x + c.x),
                 s.x_dot + sixth * (a.x + 2.0 * (b.x + c.x) + d.x)};
}

INLINE int crosses(double before, double rate, double after, double h) {
  return (after < 0.0) | ((before > 0.0) & (before + h * rate < 0.0));
}

INLINE State state_of(const Block* b, int j) {
  return (State){b->theta[j], b->theta_dot[j], b->x[j], b->x_dot[j]};
}
INLINE Phase phase_of(const Block* b, Settings q, int j) {
  return (Phase){b->M[j], b->mu[j], b->mass_ratio[j], b->slip[j], b->torque[j], q};
}

// Adds the contributions of h seconds in one phase, where `counts` is 1.
INLINE void add_motion(Block* b, int j, State s, State e, double h, double counts, double slip) {
  double start = s.theta_dot, end = e.theta_dot, moved = counts * (e.x - s.x);
  double both = 0.5 * h * (start * start + end * end) / (fabs(start) + fabs(end) + 1.0 / LARGE);
  b->energy[j] +=
      counts * fabs(b->torque[j]) * (start * end >= 0.0 ? fabs(e.theta - s.theta) : both);
  b->forward[j] += larger(0.0, moved), b->backward[j] += larger(0.0, -moved);
  b->stuck[j] += slip == 0.0 ? counts * h : 0.0;
}

INLINE void write_state(Block* b, int j, State s, double normal) {
  b->theta[j] = s.theta, b->theta_dot[j] = s.theta_dot, b->x[j] = s.x, b->x_dot[j] = s.x_dot;
  b->normal_force[j] = smaller(b->normal_force[j], normal);
  b->largest_theta[j] = larger(b->largest_theta[j], fabs(s.theta));
  b->largest_theta_dot[j] = larger(b->largest_theta_dot[j], fabs(s.theta_dot));
}

// One substep of a chunk. An environment with an event keeps its state and is marked.
INLINE void smooth_substep(Block* b, Settings q, int first, double h, int may_stick) {
  for (int j = first; j < first + CHUNK; j++) {
    Phase p = phase_of(b, q, j);
    State s = state_of(b, j);
    double mu = kinetic(p.slip, p), smallest, rate_0, rate_1, force;
    Accelerations a = accelerate(s.theta, s.theta_dot, mu, p);
    State e = runge_kutta(s, a, mu, p, h, &smallest);
    double before = p.slip * s.x_dot, rate = p.slip * a.x, after = p.slip * e.x_dot;
    if (may_stick) {
      double margin = stick_margin(s.theta, s.theta_dot, p, &rate_0, &force);
      double margin_after = stick_margin(e.theta, e.theta_dot, p, &rate_1, &force);
      before = p.slip == 0.0 ? margin : before, rate = p.slip == 0.0 ? rate_0 : rate;
      after = p.slip == 0.0 ? margin_after : after;
    }
    int event =
        crosses(before, rate, after, h) | ((p.slip != 0.0) & (e.x_dot == 0.0)) | (smallest < 0.0);
    double going = 1.0 - b->halted[j],
           counts = event | (fabs(e.theta) >= THETA_LIMIT) ? 0.0 : going;
    b->event[j] = going - counts;
    add_motion(b, j, s, e, h, counts, p.slip);
    State kept = {counts != 0.0 ? e.theta : s.theta, counts != 0.0 ? e.theta_dot : s.theta_dot,
                  counts != 0.0 ? e.x : s.x, counts != 0.0 ? e.x_dot : s.x_dot};
    write_state(b, j, kept, counts != 0.0 ? a.normal : LARGE);
  }
}

// The start of a phase with its accelerations; and a part of a substep in it, with the boundary at
// its end, which is positive while the phase lasts.
typedef struct {
  State s;
  Accelerations first;
  Phase p;
} Start;
typedef struct {
  double tau, value, rate, normal;
  State end;
  Accelerations last;
} Piece;

static double boundary(State s, double x_ddot, const Phase* p, double* rate) {
  double force;
  if (p->slip == 0.0) return stick_margin(s.theta, s.theta_dot, *p, rate, &force);
  return *rate = p->slip * x_ddot, p->slip * s.x_dot;
}

static Piece take(const Start* at, double tau) {
  double mu = kinetic(at->p.slip, at->p), normal = at->first.normal, smallest;
  State end = runge_kutta(at->s, at->first, mu, at->p, tau, &smallest);
  if (smallest < 0.0) {  // the contact is lost: without friction
    Accelerations free = accelerate(at->s.theta, at->s.theta_dot, mu = 0.0, at->p);
    end = runge_kutta(at->s, free, mu, at->p, tau, &smallest), normal = free.normal;
  }
  Piece r = {
      tau, 0.0, 0.0, larger(0.0, normal), end, accelerate(end.theta, end.theta_dot, mu, at->p)};
  r.value = boundary(end, r.last.x, &at->p, &r.rate);
  return r;
}

// The piece that ends on the boundary: Newton's method in a bracket, from the root of the cubic
// through its ends.
static Piece locate(const Start* at, double low, double before, double rate, Piece r) {
  double width = r.tau - low, high = r.tau, c = rate * width, share = before / (before - r.value),
         step = LARGE;
  double d = 3.0 * (r.value - before) - 2.0 * c - r.rate * width,
         e = 2.0 * (before - r.value) + c + r.rate * width;
  for (int i = 0; i < 3; i++) {
    double slope = (3.0 * e * share + 2.0 * d) * share + c,
           value = ((e * share + d) * share + c) * share + before;
    if (slope < 0.0) share = smaller(1.0, larger(0.0, share - value / slope));
  }
  double tau = low + share * width;
  for (int i = 0; i < 60; i++) {
    r = take(at, tau), step = r.rate < 0.0 ? -r.value / r.rate : LARGE;
    if (fabs(step) <= LAST_CORRECTION * width || fabs(r.value) <= EVENT_TOLERANCE ||
        high - low <= 1e-14 * width)
      break;
    *(r.value < 0.0 ? &high : &low) = tau, tau += step;
    if (!(low < tau && tau < high)) tau = 0.5 * (low + high);
  }
  if (fabs(step) > LAST_CORRECTION * width) return r;
  r.tau += step, r.end.theta += step * r.end.theta_dot, r.end.x += step * r.end.x_dot;
  r.end.theta_dot += step * r.last.theta, r.end.x_dot += step * r.last.x;
  return r;
}

static Piece until_event(const Start* at, double before, double rate, Piece whole) {
  Piece beyond = whole;
  if (whole.value >= 0.0) {
    double curvature = whole.value - before - rate * whole.tau;
    double dip = curvature > 0.0 ? -0.5 * rate * whole.tau * whole.tau / curvature : whole.tau;
    if (dip >= whole.tau || (beyond = take(at, dip)).value >= 0.0) return whole;
  }
  if (before > EVENT_TOLERANCE) return locate(at, 0.0, before, rate, beyond);
  for (int i = 0; i < 60; i++) {  // the phase starts on its boundary
    Piece left = take(at, 0.5 * beyond.tau);
    if (left.value > 0.0) return locate(at, left.tau, left.value, left.rate, beyond);
    beyond = left;
  }
  return beyond;
}

// A substep of one environment through every change of phase.
static void step_with_events(Block* b, Settings q, int j, double h, double elapsed) {
  Start at = {.s = state_of(b, j), .p = phase_of(b, q, j)};
  double left = h, normal = LARGE, rate, force;
  for (int count = 0; count < 1000 && left > 0.0; count++) {
    at.first = accelerate(at.s.theta, at.s.theta_dot, kinetic(at.p.slip, at.p), at.p);
    Piece r = take(&at, left);
    double before = boundary(at.s, at.first.x, &at.p, &rate);
    int crossed = crosses(before, rate, r.value, left) && count < 999,
        beyond = crossed && r.value < 0.0;
    if (crossed) r = until_event(&at, before, rate, r);
    add_motion(b, j, at.s, r.end, r.tau, 1.0, at.p.slip);
    normal = smaller(normal, r.normal), at.s = r.end;
    if (!(r.tau < left || beyond)) break;
    left -= r.tau;
    if (at.p.slip == 0.0) {
      stick_margin(at.s.theta, at.s.theta_dot, at.p, &rate, &force);
      at.p.slip = force > 0.0 ? 1.0 : -1.0;
    } else {
      at.s.x_dot = 0.0;
      at.p.slip = before <= 0.0 && r.tau <= 1e-9 * h ? 0.0 : contact_phase(at.s, at.p);
    }
  }
  write_state(b, j, at.s, normal);
  b->slip[j] = contact_phase(at.s, at.p);
  int resolved = fabs(at.s.theta_dot) + fabs(at.s.x_dot) <= 1e4;
  double reason = fabs(at.s.theta) >= THETA_LIMIT ? 1.0
                  : normal <= 0.0                 ? 2.0
                  : resolved                      ? 0.0
                                                  : 3.0;
  if (reason != 0.0)
    b->termination[j] = reason, b->halted[j] = 1.0, b->elapsed[j] = elapsed, b->slip[j] = 1.0;
}

INLINE void begin_step(Block* b, Settings q, const double* actions) {
  for (int j = 0; j < N; j++) {
    b->torque[j] = q.torque_limit * clip(actions[j], 1.0), b->mass_ratio[j] = q.m / (b->M[j] + q.m);
    b->peak_torque[j] = larger(b->peak_torque[j], fabs(b->torque[j])), b->before_x[j] = b->x[j];
    b->energy[j] = b->halted[j] = 0.0, b->normal_force[j] = LARGE, b->elapsed[j] = SUBSTEPS * q.dt;
    b->slip[j] = contact_phase(state_of(b, j), phase_of(b, q, j));
  }
}

INLINE void finish_step(Block* b, Settings q, const double* actions, float* observations) {
  for (int j = 0; j < N; j++) {
    double moved = b->x[j] - b->before_x[j], weight = (b->M[j] + q.m) * q.g,
           penalty = -q.termination_penalty;
    b->reward_progress[j] = 100.0 * moved, b->reward_energy[j] = -q.energy_weight * b->energy[j];
    b->reward_termination[j] = b->termination[j] != 0.0 ? penalty : 0.0;
    b->reward[j] = b->reward_progress[j] + b->reward_energy[j] + b->reward_termination[j];
    b->steps[j] += 1.0, b->episode_energy[j] += b->energy[j],
        b->weight_distance[j] += weight * moved;
    b->duration[j] += b->elapsed[j],
        b->torque_squared[j] += b->elapsed[j] * b->torque[j] * b->torque[j];
    double ratio = b->normal_force[j] / weight;
    b->smallest_normal_ratio[j] = smaller(b->smallest_normal_ratio[j], ratio);
    b->cost[j] =
        (ratio < 0.1) | (fabs(b->theta[j]) > 0.9 * THETA_LIMIT) | (b->termination[j] != 0.0) ? 1.0
                                                                                             : 0.0;
  }
  for (int j = 0; j < N; j++, observations += 5) {
    observations[0] = (float)clip(b->theta[j], THETA_LIMIT),
    observations[1] = (float)clip(b->theta_dot[j], 20.0);
    observations[2] = (float)clip(b->x_dot[j], 2.0), observations[4] = (float)clip(actions[j], 1.0);
    observations[3] = fabs(b->x_dot[j]) <= q.stick_threshold ? 1.0f : 0.0f;
  }
}

void step(Block* b, int blocks, const Settings* settings, const double* actions,
          float* observations) {
  Settings q =
      *settings;  // a copy: a load behind a condition would keep a loop from being vectorised
  for (Block* end = b + blocks; b < end; b++, actions += N, observations += 5 * N) {
    begin_step(b, q, actions);
    for (int substep = 1; substep <= SUBSTEPS; substep++) {
      for (int first = 0; first < N; first += CHUNK) {
        int sticks = 0;
        for (int j = first; j < first + CHUNK; j++) sticks |= b->slip[j] == 0.0;
        if (sticks)
          smooth_substep(b, q, first, q.dt, 1);
        else
          smooth_substep(b, q, first, q.dt, 0);
      }
      for (int j = 0; j < N; j++)
        if (b->event[j] != 0.0) step_with_events(b, q, j, q.dt, substep * q.dt);
    }
    finish_step(b, q, actions, observations);
  }
}
