// The speed task's step with direct torque in plain C: what a compiler makes of loops over environments, to compare with
// the core. Equations, order of the integrator, location of events, sums and rewards are those of `capsule_gym/core`; the
// rounding is the compiler's. benchmarks/plain.py compiles it with -ffast-math, and passes what the structs hold.
#include <math.h>

#define N 64     // environments in a block
#define CHUNK 8  // of them, stepped together: where none sticks, the stick's margin is left out
#define SUBSTEPS 10
#define LARGE 1e300
// Calls would keep the loops from being vectorised.
#define INLINE inline __attribute__((always_inline))

struct settings {
  double m, l, g, k, c, static_ratio, backward_ratio;
  double torque_limit, dt, energy_weight, termination_penalty, stick_threshold;
};

// The first rows are the core's.
struct block {
  double theta[N], theta_dot[N], x[N], x_dot[N], M[N], mu[N], torque[N], law_torque[N], normal_force[N], energy[N];
  double reward_progress[N], reward_energy[N], reward_termination[N], reward[N], termination[N], steps[N], start_x[N];
  double duration[N], episode_energy[N], weight_distance[N], torque_squared[N], peak_torque[N], forward[N], backward[N];
  double stuck[N], smallest_normal_ratio[N], largest_theta[N], largest_theta_dot[N];
  double slip[N], mass_ratio[N], before_x[N], event[N], halted[N], elapsed[N];
  double next_theta[N], next_theta_dot[N], next_x[N], next_x_dot[N], smallest[N];  // for a substep with an event
};
const int ROWS = sizeof(struct block) / sizeof(double) / N;

struct plant {
  double M, mu, mass_ratio;
  struct settings q;
};
struct state {
  double theta, theta_dot, x, x_dot;
};
struct acceleration {
  double theta, x, normal;
};
struct margin {
  double value, force;
};

static INLINE double larger(double a, double b) { return a > b ? a : b; }
static INLINE double smaller(double a, double b) { return a < b ? a : b; }
static INLINE double kinetic(double slip, struct plant p) { return slip < 0.0 ? p.mu * p.q.backward_ratio : p.mu; }

// The angle is brought to +-pi and halved: libm's vectorised functions take longer.
static INLINE void sine_cosine(double angle, double *sine, double *cosine) {
  double y = 0.5 * (angle - 6.283185307179586 * rint(angle * 0.15915494309189535)), z = y * y, zz = z * z;
  // In pairs, which wait for one another less than Horner's scheme.
  double s = ((2.731428986122616e-15 * z - 7.643969031052769e-13) * zz + (1.6058977272815506e-10 * z - 2.5052107616384595e-08)) * (zz * zz) +
      ((2.755731921915843e-06 * z - 0.00019841269841254955) * zz + (0.008333333333333316 * z - 0.16666666666666666));
  double c = ((-1.521855926409455e-16 * z + 4.777877290768691e-14) * zz + (-1.1470712252875163e-11 * z + 2.0876756602568905e-09)) * (zz * zz) +
      ((-2.7557319221567154e-07 * z + 2.4801587301579844e-05) * zz + (-0.001388888888888888 * z + 0.041666666666666664));
  s = y + y * z * s, c = 1.0 - 0.5 * z + z * z * c;
  *sine = 2.0 * s * c, *cosine = 1.0 - 2.0 * s * s;
}

static INLINE double stick_acceleration(double theta, double theta_dot, double sine, double u, struct plant p) {
  double l = p.q.l, inertia = p.q.m * l * l;
  return p.q.g / l * sine + (u - p.q.k * theta - p.q.c * theta_dot) * (1.0 / inertia);
}

// Eq. (1) with the friction slip mu N; N is not clamped.
static INLINE struct acceleration accelerate(double theta, double theta_dot, double slip, double mu, double u, struct plant p) {
  double l = p.q.l, g = p.q.g, share = slip * slip * p.mass_ratio, rough = slip * mu, sine, cosine;
  sine_cosine(theta, &sine, &cosine);
  double squared = theta_dot * theta_dot, tilted = cosine + rough * sine;
  double rest = share * l * (rough * cosine - sine) * squared - rough * g;
  double free = stick_acceleration(theta, theta_dot, sine, u, p);
  double a = (free + cosine * (1.0 / l) * rest) / (1.0 - share * cosine * tilted);
  return (struct acceleration){a, rest + share * l * tilted * a, (p.M + p.q.m) * g - p.q.m * l * (squared * cosine + a * sine)};
}

// Static friction limit minus load of a platform at rest, its rate in time, and the load.
static INLINE struct margin stick_margin(double theta, double theta_dot, double u, struct plant p, double *rate) {
  double sine, cosine, ml = p.q.m * p.q.l, w = theta_dot, g = p.q.g;
  sine_cosine(theta, &sine, &cosine);
  double a = stick_acceleration(theta, w, sine, u, p), force = ml * (cosine * a - sine * w * w);
  double rough = p.q.static_ratio * kinetic(force, p);
  double limit = rough * larger(0.0, (p.M + p.q.m) * g - ml * (a * sine + w * w * cosine));
  double jerk = (ml * g * cosine * w - p.q.k * w - p.q.c * a) / (ml * p.q.l);
  double force_rate = ml * (cosine * jerk - 3.0 * sine * w * a - cosine * w * w * w);
  double limit_rate = -rough * ml * (sine * jerk + 3.0 * cosine * w * a - sine * w * w * w);
  *rate = force > 0.0 ? limit_rate - force_rate : limit_rate + force_rate;
  return (struct margin){limit - fabs(force), force};
}

static INLINE double phase(double theta, double theta_dot, double x_dot, double u, struct plant p) {
  double rate;
  struct margin at_rest = stick_margin(theta, theta_dot, u, p, &rate);
  double rests = at_rest.value >= 0.0 ? 0.0 : at_rest.force > 0.0 ? 1.0 : -1.0;
  return x_dot > 0.0 ? 1.0 : x_dot < 0.0 ? -1.0 : rests;
}

// A Runge-Kutta step in one phase from the state s with the accelerations a: the state at its end, and the smallest N of
// its stages.
static INLINE struct state runge_kutta(struct state s, double slip, double mu, double u, struct plant p, double h,
                                       struct acceleration a, double *smallest) {
  double half = 0.5 * h, sixth = h / 6.0, theta_2 = s.theta + half * s.theta_dot;
  struct acceleration b = accelerate(theta_2, s.theta_dot + half * a.theta, slip, mu, u, p);
  struct acceleration c = accelerate(theta_2 + half * half * a.theta, s.theta_dot + half * b.theta, slip, mu, u, p);
  double theta_4 = s.theta + h * s.theta_dot + half * h * b.theta;
  struct acceleration d = accelerate(theta_4, s.theta_dot + h * c.theta, slip, mu, u, p);
  *smallest = smaller(smaller(a.normal, b.normal), smaller(c.normal, d.normal));
  return (struct state){s.theta + h * s.theta_dot + h * sixth * (a.theta + b.theta + c.theta),
                        s.theta_dot + sixth * (a.theta + 2.0 * (b.theta + c.theta) + d.theta),
                        s.x + h * s.x_dot + h * sixth * (a.x + b.x + c.x), s.x_dot + sixth * (a.x + 2.0 * (b.x + c.x) + d.x)};
}

// Integral of |theta_dot| over h seconds.
static INLINE double swept(double start, double end, double turned, double h) {
  double both = 0.5 * h * (start * start + end * end) / (fabs(start) + fabs(end) + 1e-300);
  return start * end >= 0.0 ? fabs(turned) : both;
}

static INLINE int crosses(double before, double rate, double after, double h) {
  return (after < 0.0) | ((before > 0.0) & (before + h * rate < 0.0));
}

static INLINE struct plant plant_of(const struct block *b, struct settings q, int j) {
  return (struct plant){b->M[j], b->mu[j], b->mass_ratio[j], q};
}

static INLINE void add_motion(struct block *b, int j, struct state s, struct state e, double h, double counts, double sticks) {
  double moved = counts * (e.x - s.x);
  b->energy[j] += counts * fabs(b->torque[j]) * swept(s.theta_dot, e.theta_dot, e.theta - s.theta, h);
  b->forward[j] += larger(0.0, moved), b->backward[j] += larger(0.0, -moved), b->stuck[j] += counts * sticks * h;
}

// One substep of a chunk. An environment with an event keeps its state and is marked.
static INLINE void smooth_substep(struct block *b, struct settings q, int first, double h, int may_stick) {
  for (int j = first; j < first + CHUNK; j++) {
    struct plant p = plant_of(b, q, j);
    struct state s = {b->theta[j], b->theta_dot[j], b->x[j], b->x_dot[j]};
    double slip = b->slip[j], u = b->torque[j], smallest, rate_0, rate_1;
    struct acceleration a = accelerate(s.theta, s.theta_dot, slip, kinetic(slip, p), u, p);
    struct state e = runge_kutta(s, slip, kinetic(slip, p), u, p, h, a, &smallest);
    double before = slip * s.x_dot, rate = slip * a.x, after = slip * e.x_dot;
    int stopped = e.x_dot == 0.0;
    if (may_stick) {
      struct margin m_0 = stick_margin(s.theta, s.theta_dot, u, p, &rate_0), m_1 = stick_margin(e.theta, e.theta_dot, u, p, &rate_1);
      before = slip == 0.0 ? m_0.value : before, rate = slip == 0.0 ? rate_0 : rate, after = slip == 0.0 ? m_1.value : after;
      stopped &= slip != 0.0;
    }
    int going = b->halted[j] == 0.0;
    int event = crosses(before, rate, after, h) | stopped | (smallest < 0.0) | (fabs(e.theta) >= 1.5707963267948966);
    double counts = going & !event ? 1.0 : 0.0;
    b->event[j] = going & event ? 1.0 : 0.0;
    b->next_theta[j] = e.theta, b->next_theta_dot[j] = e.theta_dot, b->next_x[j] = e.x, b->next_x_dot[j] = e.x_dot;
    b->smallest[j] = smallest;
    b->theta[j] = counts != 0.0 ? e.theta : s.theta, b->theta_dot[j] = counts != 0.0 ? e.theta_dot : s.theta_dot;
    b->x[j] = counts != 0.0 ? e.x : s.x, b->x_dot[j] = counts != 0.0 ? e.x_dot : s.x_dot;
    add_motion(b, j, s, e, h, counts, slip == 0.0 ? 1.0 : 0.0);
    b->normal_force[j] = smaller(b->normal_force[j], counts != 0.0 ? a.normal : LARGE);
    b->largest_theta[j] = larger(b->largest_theta[j], fabs(b->theta[j]));
    b->largest_theta_dot[j] = larger(b->largest_theta_dot[j], fabs(b->theta_dot[j]));
  }
}

// The start of a phase, with its accelerations.
struct start {
  struct state s;
  double slip, u;
  struct plant p;
  struct acceleration first;
};

// A part of a substep in one phase, and at its end the boundary that is positive while the phase lasts.
struct piece {
  double tau, value, rate, normal;
  struct state end;
  struct acceleration last;
};

static struct acceleration accelerations(struct state s, double slip, double mu, double u, struct plant p) {
  return accelerate(s.theta, s.theta_dot, slip, mu, u, p);
}

static double boundary(struct state s, double x_ddot, const struct start *at, double *rate) {
  if (at->slip == 0.0) return stick_margin(s.theta, s.theta_dot, at->u, at->p, rate).value;
  return *rate = at->slip * x_ddot, at->slip * s.x_dot;
}

static struct piece take(const struct start *at, double tau, const struct state *known, double smallest) {
  double mu = kinetic(at->slip, at->p);
  struct acceleration first = at->first;
  struct state end = known ? *known : runge_kutta(at->s, at->slip, mu, at->u, at->p, tau, first, &smallest);
  if (smallest < 0.0) {  // the contact is lost: the platform is free
    first = accelerations(at->s, at->slip, mu = 0.0, at->u, at->p);
    end = runge_kutta(at->s, at->slip, mu, at->u, at->p, tau, first, &smallest);
  }
  struct piece r = {tau, 0.0, 0.0, larger(0.0, first.normal), end, accelerations(end, at->slip, mu, at->u, at->p)};
  r.value = boundary(end, r.last.x, at, &r.rate);
  return r;
}

// The piece that ends on the boundary: Newton's method in a bracket, from the root of the cubic through its ends.
static struct piece locate(const struct start *at, double low, double g_0, double r_0, struct piece beyond) {
  double width = beyond.tau - low, high = beyond.tau, g_1 = beyond.value, c = r_0 * width;
  double d = 3.0 * (g_1 - g_0) - 2.0 * c - beyond.rate * width, e = 2.0 * (g_0 - g_1) + c + beyond.rate * width;
  double share = g_0 / (g_0 - g_1);
  for (int i = 0; i < 3; i++) {
    double slope = (3.0 * e * share + 2.0 * d) * share + c;
    if (slope < 0.0) share = smaller(1.0, larger(0.0, share - (((e * share + d) * share + c) * share + g_0) / slope));
  }
  double tau = low + share * width, step = LARGE;
  for (int i = 0; i < 60; i++) {
    beyond = take(at, tau, 0, 0.0);
    step = beyond.rate < 0.0 ? -beyond.value / beyond.rate : LARGE;
    if (fabs(step) <= 1e-6 * width || fabs(beyond.value) <= 1e-15 || high - low <= 1e-14 * width) break;
    *(beyond.value < 0.0 ? &high : &low) = tau, tau += step;
    if (!(low < tau && tau < high)) tau = 0.5 * (low + high);
  }
  if (fabs(step) > 1e-6 * width) return beyond;
  // The rest is so small that the state follows its tangent.
  beyond.tau += step, beyond.end.theta += step * beyond.end.theta_dot, beyond.end.x += step * beyond.end.x_dot;
  beyond.end.theta_dot += step * beyond.last.theta, beyond.end.x_dot += step * beyond.last.x;
  return beyond;
}

static struct piece until_event(const struct start *at, double before, double rate, struct piece whole) {
  struct piece beyond = whole;
  if (whole.value >= 0.0) {
    double curvature = whole.value - before - rate * whole.tau;
    double dip = curvature > 0.0 ? -0.5 * rate * whole.tau * whole.tau / curvature : whole.tau;
    if (dip >= whole.tau || (beyond = take(at, dip, 0, 0.0)).value >= 0.0) return whole;
  }
  if (before > 1e-15) return locate(at, 0.0, before, rate, beyond);
  // The phase starts on its boundary.
  for (int i = 0; i < 60; i++) {
    struct piece left = take(at, 0.5 * beyond.tau, 0, 0.0);
    if (left.value > 0.0) return locate(at, left.tau, left.value, left.rate, beyond);
    beyond = left;
  }
  return beyond;
}

// A substep of one environment through every change of phase.
static void step_with_events(struct block *b, struct settings q, int j, double h, double elapsed) {
  struct start at = {{b->theta[j], b->theta_dot[j], b->x[j], b->x_dot[j]}, b->slip[j], b->torque[j], plant_of(b, q, j), {0}};
  struct state s = at.s, next = {b->next_theta[j], b->next_theta_dot[j], b->next_x[j], b->next_x_dot[j]};
  double left = h, normal = LARGE, rate;
  for (int count = 0; count < 1000 && left > 0.0; count++) {
    at.s = s, at.first = accelerations(s, at.slip, kinetic(at.slip, at.p), at.u, at.p);
    struct piece r = take(&at, left, count == 0 ? &next : 0, b->smallest[j]);
    double before = boundary(s, at.first.x, &at, &rate);
    int crossed = crosses(before, rate, r.value, left) && count < 999, beyond = crossed && r.value < 0.0;
    if (crossed) r = until_event(&at, before, rate, r);
    add_motion(b, j, s, r.end, r.tau, 1.0, at.slip == 0.0 ? 1.0 : 0.0);
    normal = smaller(normal, r.normal), s = r.end;
    if (!(r.tau < left || beyond)) break;
    left -= r.tau;
    if (at.slip == 0.0) {
      at.slip = stick_margin(s.theta, s.theta_dot, at.u, at.p, &rate).force > 0.0 ? 1.0 : -1.0;
    } else {
      s.x_dot = 0.0;
      at.slip = before <= 0.0 && r.tau <= 1e-9 * h ? 0.0 : phase(s.theta, s.theta_dot, 0.0, at.u, at.p);
    }
  }
  b->theta[j] = s.theta, b->theta_dot[j] = s.theta_dot, b->x[j] = s.x, b->x_dot[j] = s.x_dot;
  b->slip[j] = phase(s.theta, s.theta_dot, s.x_dot, at.u, at.p), b->normal_force[j] = smaller(b->normal_force[j], normal);
  b->largest_theta[j] = larger(b->largest_theta[j], fabs(s.theta));
  b->largest_theta_dot[j] = larger(b->largest_theta_dot[j], fabs(s.theta_dot));
  double reason = fabs(s.theta) >= 1.5707963267948966 ? 1.0 : normal <= 0.0 ? 2.0 : fabs(s.theta_dot) + fabs(s.x_dot) > 1e4 ? 3.0 : 0.0;
  if (reason != 0.0) b->termination[j] = reason, b->halted[j] = 1.0, b->elapsed[j] = elapsed, b->slip[j] = 1.0;
}

static void begin_step(struct block *b, struct settings q, const double *actions) {
  for (int j = 0; j < N; j++) {
    double action = smaller(1.0, larger(-1.0, actions[j])), u = q.torque_limit * action;
    b->mass_ratio[j] = q.m / (b->M[j] + q.m), b->before_x[j] = b->x[j], b->energy[j] = b->halted[j] = 0.0;
    b->normal_force[j] = LARGE, b->elapsed[j] = SUBSTEPS * q.dt, b->torque[j] = u;
    b->peak_torque[j] = larger(b->peak_torque[j], fabs(u));
    b->slip[j] = phase(b->theta[j], b->theta_dot[j], b->x_dot[j], u, plant_of(b, q, j));
  }
}

static void finish_step(struct block *b, struct settings q, const double *actions, float *observations) {
  for (int j = 0; j < N; j++) {
    double moved = b->x[j] - b->before_x[j], weight = (b->M[j] + q.m) * q.g, energy = b->energy[j];
    double progress = 100.0 * moved, cost = -q.energy_weight * energy;
    double penalty = b->termination[j] != 0.0 ? -q.termination_penalty : 0.0;
    b->reward[j] = progress + cost + penalty, b->reward_progress[j] = progress, b->reward_energy[j] = cost;
    b->reward_termination[j] = penalty, b->steps[j] += 1.0, b->episode_energy[j] += energy;
    b->duration[j] += b->elapsed[j], b->torque_squared[j] += b->elapsed[j] * b->torque[j] * b->torque[j];
    b->weight_distance[j] += weight * moved;
    b->smallest_normal_ratio[j] = smaller(b->smallest_normal_ratio[j], b->normal_force[j] / weight);
  }
  for (int j = 0; j < N; j++) {
    float *out = observations + 5 * j;
    out[0] = (float)smaller(1.5707963267948966, larger(-1.5707963267948966, b->theta[j]));
    out[1] = (float)smaller(20.0, larger(-20.0, b->theta_dot[j]));
    out[2] = (float)smaller(2.0, larger(-2.0, b->x_dot[j]));
    out[3] = fabs(b->x_dot[j]) <= q.stick_threshold ? 1.0f : 0.0f;
    out[4] = (float)smaller(1.0, larger(-1.0, actions[j]));
  }
}

void step(struct block *blocks, int count, const struct settings *settings, const double *actions, float *observations) {
  // Copies: a load behind a condition would keep a loop from being vectorised.
  struct settings q = *settings;
  for (int i = 0; i < count; i++) {
    struct block *b = blocks + i;
    begin_step(b, q, actions + N * i);
    for (int substep = 1; substep <= SUBSTEPS; substep++) {
      for (int first = 0; first < N; first += CHUNK) {
        int sticks = 0;
        for (int j = first; j < first + CHUNK; j++) sticks |= b->slip[j] == 0.0;
        if (sticks) smooth_substep(b, q, first, q.dt, 1);
        else smooth_substep(b, q, first, q.dt, 0);
      }
      for (int j = 0; j < N; j++)
        if (b->event[j] != 0.0) step_with_events(b, q, j, q.dt, substep * q.dt);
    }
    finish_step(b, q, actions + N * i, observations + 5 * N * i);
  }
}
