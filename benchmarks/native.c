/* The agent step under direct torque, by hand in C: what `capsule_gym.kernels.advance` is measured against.
 *
 * The same work on the same memory: blocks of LANES environments, Runge-Kutta in a loop over the lanes, events located
 * one by one, rewards, sums of the episode and observations. The rows' offsets (ROW_theta, ROW_x, ..) and LANES come from the
 * compiler's command line, which benchmarks/native.py writes from `capsule_gym.kernels`, so that they exist once.
 *
 * Newton's normal force, the default of `Capsule`. Nothing here is part of the package.
 */
#include <math.h>
#include <stdint.h>

typedef struct {
    double m, l, g, k, c, static_ratio, backward_ratio;
} Robot;

typedef struct {
    double torque_limit, residual_limit, physics_dt, energy_weight, termination_penalty;
    double theta_limit, theta_dot_bound, x_dot_bound;
    int64_t physics_steps;
} Settings;

typedef struct {
    double M, mu, ratio;
} Floor;

typedef struct {
    double theta, theta_dot, x, x_dot, x_ddot, normal, smallest;
} Stage;

typedef struct {
    double tau, theta, theta_dot, x, x_dot, boundary, rate, theta_ddot, x_ddot, first_x_ddot, normal;
} Piece;

static inline double clip(double value, double limit) {
    return value > limit ? limit : value < -limit ? -limit : value;
}
static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }

static inline void sine_cosine(double angle, double *sine, double *cosine) {
    const double turns = rint(angle * 0.15915494309189535);
    const double y = 0.5 * ((angle - turns * 6.283185307179586) - turns * 2.4492935982947064e-16);
    const double z = y * y;
    const double zz = z * z, z4 = zz * zz;
    const double s = ((2.731428986122616e-15 * z - 7.643969031052769e-13) * zz
                      + (1.6058977272815506e-10 * z - 2.5052107616384595e-08)) * z4
                     + ((2.755731921915843e-06 * z - 0.00019841269841254955) * zz
                        + (0.008333333333333316 * z - 0.16666666666666666));
    const double c = ((-1.521855926409455e-16 * z + 4.777877290768691e-14) * zz
                      + (-1.1470712252875163e-11 * z + 2.0876756602568905e-09)) * z4
                     + ((-2.7557319221567154e-07 * z + 2.4801587301579844e-05) * zz
                        + (-0.001388888888888888 * z + 0.041666666666666664));
    const double half_sine = y * z * s + y, half_cosine = zz * c + (1.0 - 0.5 * z);
    *sine = 2.0 * half_sine * half_cosine;
    *cosine = 1.0 - 2.0 * half_sine * half_sine;
}

static inline double friction(double slip, Floor f, Robot r) { return slip < 0.0 ? f.mu * r.backward_ratio : f.mu; }

static inline void accelerate(double theta, double theta_dot, double slip, double mu, double u, Floor f, Robot r,
                              double *theta_ddot, double *x_ddot, double *normal) {
    double sine, cosine;
    sine_cosine(theta, &sine, &cosine);
    const double inertia = r.m * r.l * r.l, share = slip * slip * f.ratio, rough = slip * mu;
    const double squared = theta_dot * theta_dot, tilted = rough * sine + cosine;
    const double rest = share * r.l * ((rough * cosine - sine) * squared) - rough * r.g;
    const double free = (r.g / r.l) * sine - (r.k / inertia) * theta - (r.c / inertia) * theta_dot + u * (1.0 / inertia);
    const double a = (cosine * (1.0 / r.l) * rest + free) * (1.0 / (1.0 - share * cosine * tilted));
    *theta_ddot = a;
    *x_ddot = share * r.l * tilted * a + rest;
    *normal = (f.M + r.m) * r.g - r.m * r.l * (squared * cosine + a * sine);
}

static inline Stage runge_kutta(double theta, double theta_dot, double x, double x_dot, double slip, double mu,
                                double u, Floor f, Robot r, double h) {
    const double half = 0.5 * h, sixth = h / 6.0, theta_2 = theta + half * theta_dot;
    double a1, a2, a3, a4, b1, b2, b3, b4, n1, n2, n3, n4;
    accelerate(theta, theta_dot, slip, mu, u, f, r, &a1, &b1, &n1);
    accelerate(theta_2, theta_dot + half * a1, slip, mu, u, f, r, &a2, &b2, &n2);
    accelerate(theta_2 + half * half * a1, theta_dot + half * a2, slip, mu, u, f, r, &a3, &b3, &n3);
    accelerate(theta + h * theta_dot + half * h * a2, theta_dot + h * a3, slip, mu, u, f, r, &a4, &b4, &n4);
    return (Stage){theta + h * theta_dot + h * sixth * (a1 + a2 + a3),
                   theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
                   x + h * x_dot + h * sixth * (b1 + b2 + b3),
                   x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4),
                   b1,
                   n1,
                   smaller(smaller(n1, n2), smaller(n3, n4))};
}

/* The static limit minus the load, its rate along a stick phase, and the load. */
static inline void stick(double theta, double theta_dot, double u, Floor f, Robot r, double *margin, double *rate,
                         double *load) {
    double sine, cosine;
    sine_cosine(theta, &sine, &cosine);
    const double ml = r.m * r.l, inertia = ml * r.l;
    const double a = (u + ml * r.g * sine - r.k * theta - r.c * theta_dot) / inertia;
    const double force = ml * (cosine * a - sine * theta_dot * theta_dot);
    const double normal = (f.M + r.m) * r.g - ml * (a * sine + theta_dot * theta_dot * cosine);
    const double mu = r.static_ratio * friction(force, f, r);
    const double jerk = (ml * r.g * cosine * theta_dot - r.k * theta_dot - r.c * a) / inertia;
    const double cubed = theta_dot * theta_dot * theta_dot;
    const double force_rate = ml * (cosine * jerk - 3.0 * sine * theta_dot * a - cosine * cubed);
    const double normal_rate = -ml * (sine * jerk + 3.0 * cosine * theta_dot * a - sine * cubed);
    *margin = mu * larger(0.0, normal) - fabs(force);
    *rate = mu * normal_rate - (force > 0.0 ? force_rate : -force_rate);
    *load = force;
}

static inline double phase(double theta, double theta_dot, double x_dot, double u, Floor f, Robot r) {
    double margin, rate, load;
    stick(theta, theta_dot, u, f, r, &margin, &rate, &load);
    const double at_rest = margin >= 0.0 ? 0.0 : load > 0.0 ? 1.0 : -1.0;
    return x_dot > 0.0 ? 1.0 : x_dot < 0.0 ? -1.0 : at_rest;
}

static inline double swept(double start, double end, double turned, double h) {
    const double through = 0.5 * h * (start * start + end * end) / (fabs(start) + fabs(end));
    return start * end >= 0.0 ? fabs(turned) : through;
}

static Piece finish(Stage s, double slip, double u, Floor f, Robot r, double tau) {
    double a, b, n, load, boundary, rate;
    accelerate(s.theta, s.theta_dot, slip, friction(slip, f, r), u, f, r, &a, &b, &n);
    if (n < 0.0) accelerate(s.theta, s.theta_dot, slip, 0.0, u, f, r, &a, &b, &n);
    boundary = slip * s.x_dot, rate = slip * b;
    if (slip == 0.0) stick(s.theta, s.theta_dot, u, f, r, &boundary, &rate, &load);
    return (Piece){tau, s.theta, s.theta_dot, s.x, s.x_dot, boundary, rate, a, b, s.x_ddot, larger(0.0, s.normal)};
}

static Piece piece(double theta, double theta_dot, double x, double x_dot, double slip, double u, Floor f, Robot r,
                   double tau) {
    Stage s = runge_kutta(theta, theta_dot, x, x_dot, slip, friction(slip, f, r), u, f, r, tau);
    if (s.smallest < 0.0) s = runge_kutta(theta, theta_dot, x, x_dot, slip, 0.0, u, f, r, tau);
    return finish(s, slip, u, f, r, tau);
}

static double first_guess(double low, double low_rate, double high, double high_rate, double width) {
    const double c = low_rate * width, end = high_rate * width;
    const double d = 3.0 * (high - low) - 2.0 * c - end, e = 2.0 * (low - high) + c + end;
    double s = low / (low - high);
    for (int i = 0; i < 3; i++) {
        const double value = ((e * s + d) * s + c) * s + low, slope = (3.0 * e * s + 2.0 * d) * s + c;
        if (slope < 0.0) s = smaller(1.0, larger(0.0, s - value / slope));
    }
    return s * width;
}

static Piece until_event(double theta, double theta_dot, double x, double x_dot, double slip, double u, Floor f,
                         Robot r, double before, double rate, Piece whole) {
    Piece high = whole, trial = whole;
    if (whole.boundary >= 0.0) {
        const double curvature = whole.boundary - before - rate * whole.tau;
        const double dip = curvature > 0.0 ? -0.5 * rate * whole.tau * whole.tau / curvature : whole.tau;
        if (dip >= whole.tau) return whole;
        high = piece(theta, theta_dot, x, x_dot, slip, u, f, r, dip);
        if (high.boundary >= 0.0) return whole;
    }
    double low = 0.0, low_value = before, low_rate = rate;
    if (before <= 1e-15) {
        for (int i = 0; i < 60; i++) {
            trial = piece(theta, theta_dot, x, x_dot, slip, u, f, r, 0.5 * high.tau);
            if (trial.boundary > 0.0) break;
            high = trial;
        }
        if (trial.boundary <= 0.0) return high;
        low = trial.tau, low_value = trial.boundary, low_rate = trial.rate;
    }
    const double width = high.tau - low;
    double end = high.tau, correction = INFINITY;
    double tau = low + first_guess(low_value, low_rate, high.boundary, high.rate, width);
    for (int i = 0; i < 60; i++) {
        trial = piece(theta, theta_dot, x, x_dot, slip, u, f, r, tau);
        correction = trial.rate < 0.0 ? -trial.boundary / trial.rate : 1e300;
        if (fabs(correction) <= 1e-6 * width || fabs(trial.boundary) <= 1e-15 || end - low <= 1e-14 * width) break;
        if (trial.boundary < 0.0) end = tau;
        else low = tau;
        tau += correction;
        if (!(low < tau && tau < end)) tau = 0.5 * (low + end);
    }
    if (fabs(correction) > 1e-6 * width) return trial;
    trial.tau += correction;
    trial.theta += correction * trial.theta_dot;
    trial.theta_dot += correction * trial.theta_ddot;
    trial.x += correction * trial.x_dot;
    trial.x_dot += correction * trial.x_ddot;
    return trial;
}

/* One lane through a substep in which something happens. */
static int follow(double *b, int j, Robot r, const Settings *s, double elapsed) {
    const Floor f = {b[ROW_M + j], b[ROW_mu + j], b[ROW_mass_ratio + j]};
    const double u = b[ROW_torque + j], h = s->physics_dt;
    double theta = b[ROW_theta + j], theta_dot = b[ROW_theta_dot + j], x = b[ROW_x + j], x_dot = b[ROW_x_dot + j];
    double remaining = h, turned = 0.0, smallest = INFINITY, margin, rate, load;
    double slip = b[ROW_slip + j];
    const Stage whole = {b[ROW_next_theta + j], b[ROW_next_theta_dot + j], b[ROW_next_x + j], b[ROW_next_x_dot + j],
                         b[ROW_x_ddot + j], b[ROW_first_normal_force + j], b[ROW_least_normal_force + j]};
    for (int i = 0; i < 1000; i++) {
        Piece done = i == 0 && whole.smallest >= 0.0 ? finish(whole, slip, u, f, r, h)
                                                     : piece(theta, theta_dot, x, x_dot, slip, u, f, r, remaining);
        double before = slip * x_dot;
        rate = slip * done.first_x_ddot;
        if (slip == 0.0) stick(theta, theta_dot, u, f, r, &before, &rate, &load);
        const int crossed = done.boundary < 0.0 || (before > 0.0 && before + remaining * rate < 0.0);
        const int beyond = crossed && done.boundary < 0.0;
        if (crossed) done = until_event(theta, theta_dot, x, x_dot, slip, u, f, r, before, rate, done);
        const int ended = done.tau < remaining || beyond;
        smallest = smaller(smallest, done.normal);
        turned += swept(theta_dot, done.theta_dot, done.theta - theta, done.tau);
        b[ROW_forward + j] += larger(0.0, done.x - x);
        b[ROW_backward + j] += larger(0.0, x - done.x);
        if (slip == 0.0) b[ROW_stuck + j] += done.tau;
        theta = done.theta, theta_dot = done.theta_dot, x = done.x, x_dot = done.x_dot;
        remaining -= done.tau;
        if (!ended) break;
        if (slip == 0.0) {
            stick(theta, theta_dot, u, f, r, &margin, &rate, &load);
            slip = load > 0.0 ? 1.0 : -1.0;
        } else {
            x_dot = 0.0;
            slip = before <= 0.0 && done.tau <= 1e-9 * h ? 0.0 : phase(theta, theta_dot, x_dot, u, f, r);
        }
        if (remaining <= 0.0) break;
    }
    b[ROW_theta + j] = theta, b[ROW_theta_dot + j] = theta_dot, b[ROW_x + j] = x, b[ROW_x_dot + j] = x_dot;
    b[ROW_energy + j] += fabs(u) * turned;
    b[ROW_normal_force + j] = smaller(b[ROW_normal_force + j], smallest);
    b[ROW_largest_theta + j] = larger(b[ROW_largest_theta + j], fabs(theta));
    b[ROW_largest_theta_dot + j] = larger(b[ROW_largest_theta_dot + j], fabs(theta_dot));
    const double previous = b[ROW_slip + j];
    b[ROW_slip + j] = phase(theta, theta_dot, x_dot, u, f, r);
    if (fabs(theta) >= s->theta_limit || smallest <= 0.0) {
        b[ROW_termination + j] = fabs(theta) >= s->theta_limit ? 1.0 : 2.0;
        b[ROW_halt + j] = 1.0;
        b[ROW_elapsed + j] = elapsed;
        b[ROW_slip + j] = 1.0;
    }
    return (b[ROW_slip + j] == 0.0) - (previous == 0.0);
}

/* Every lane through a substep in which nothing happens; the others are marked. */
static inline __attribute__((always_inline)) void glide(double *restrict b, int n, Robot r, const Settings *s,
                                                        int may_stick) {
    const double h = s->physics_dt, limit = s->theta_limit;
#pragma GCC ivdep
    for (int j = 0; j < n; j++) {
        const Floor f = {b[ROW_M + j], b[ROW_mu + j], b[ROW_mass_ratio + j]};
        const double theta = b[ROW_theta + j], theta_dot = b[ROW_theta_dot + j], x = b[ROW_x + j], x_dot = b[ROW_x_dot + j];
        const double slip = b[ROW_slip + j], u = b[ROW_torque + j];
        const Stage next = runge_kutta(theta, theta_dot, x, x_dot, slip, friction(slip, f, r), u, f, r, h);
        b[ROW_next_theta + j] = next.theta, b[ROW_next_theta_dot + j] = next.theta_dot;
        b[ROW_next_x + j] = next.x, b[ROW_next_x_dot + j] = next.x_dot, b[ROW_x_ddot + j] = next.x_ddot;
        b[ROW_first_normal_force + j] = next.normal, b[ROW_least_normal_force + j] = next.smallest;
        double before = slip * x_dot, rate = slip * next.x_ddot, after = slip * next.x_dot, load, unused;
        int event = next.x_dot == 0.0;
        if (may_stick) {
            double before_0, rate_0, after_0;
            stick(theta, theta_dot, u, f, r, &before_0, &rate_0, &load);
            stick(next.theta, next.theta_dot, u, f, r, &after_0, &unused, &load);
            before = slip == 0.0 ? before_0 : before;
            rate = slip == 0.0 ? rate_0 : rate;
            after = slip == 0.0 ? after_0 : after;
            event = event & (slip != 0.0);
        }
        event = event | (after < 0.0) | ((before > 0.0) & (before + h * rate < 0.0)) | (next.smallest < 0.0)
                | (fabs(next.theta) >= limit) | (next.normal <= 0.0);
        const int going = b[ROW_halt + j] == 0.0, commit = going & !event;
        b[ROW_eventful + j] = going & event ? 1.0 : 0.0;
        b[ROW_theta + j] = commit ? next.theta : theta;
        b[ROW_theta_dot + j] = commit ? next.theta_dot : theta_dot;
        b[ROW_x + j] = commit ? next.x : x;
        b[ROW_x_dot + j] = commit ? next.x_dot : x_dot;
        const double moved = commit ? next.x - x : 0.0;
        const double turned = commit ? swept(theta_dot, next.theta_dot, next.theta - theta, h) : 0.0;
        b[ROW_energy + j] += fabs(u) * turned;
        b[ROW_forward + j] += larger(0.0, moved);
        b[ROW_backward + j] += larger(0.0, -moved);
        if (may_stick) b[ROW_stuck + j] += commit & (slip == 0.0) ? h : 0.0;
        b[ROW_normal_force + j] = smaller(b[ROW_normal_force + j], commit ? next.normal : INFINITY);
        b[ROW_largest_theta + j] = larger(b[ROW_largest_theta + j], commit ? fabs(next.theta) : 0.0);
        b[ROW_largest_theta_dot + j] = larger(b[ROW_largest_theta_dot + j], commit ? fabs(next.theta_dot) : 0.0);
    }
}

/* world: (blocks, stride); observations: (environments, 5). */
void advance(double *restrict world, int64_t stride, int64_t first, int64_t last, Robot r, Settings settings,
             float *restrict observations) {
    const Settings *s = &settings;
    const double period = (double)s->physics_steps * s->physics_dt;
    for (int64_t block = first / LANES; block * LANES < last; block++) {
        double *restrict b = world + block * stride;
        const int n = (int)(last - block * LANES < LANES ? last - block * LANES : LANES);
        int sticking = 0, resting = 0;
        for (int j = 0; j < n; j++) {
            const int active = b[ROW_active + j] != 0.0;
            b[ROW_halt + j] = active ? 0.0 : 2.0;
            b[ROW_action + j] = clip(b[ROW_action + j], 1.0);
            b[ROW_mass_ratio + j] = r.m / (b[ROW_M + j] + r.m);
            b[ROW_before_x + j] = b[ROW_x + j];
            b[ROW_energy + j] = active ? 0.0 : b[ROW_energy + j];
            b[ROW_normal_force + j] = active ? INFINITY : b[ROW_normal_force + j];
            const double torque = clip(s->residual_limit * b[ROW_action + j], s->torque_limit);
            b[ROW_torque + j] = active ? torque : b[ROW_torque + j];
            b[ROW_peak_torque + j] = larger(b[ROW_peak_torque + j], fabs(b[ROW_torque + j]));
            b[ROW_elapsed + j] = period;
            b[ROW_slip + j] = b[ROW_x_dot + j] < 0.0 ? -1.0 : 1.0;
            resting += active & (b[ROW_x_dot + j] == 0.0);
        }
        for (int j = 0; resting > 0 && j < n; j++) {
            const Floor f = {b[ROW_M + j], b[ROW_mu + j], b[ROW_mass_ratio + j]};
            const double slip = phase(b[ROW_theta + j], b[ROW_theta_dot + j], b[ROW_x_dot + j], b[ROW_torque + j], f, r);
            b[ROW_slip + j] = b[ROW_halt + j] == 0.0 ? slip : 1.0;
            sticking += b[ROW_slip + j] == 0.0;
        }
        for (int64_t substep = 0; substep < s->physics_steps; substep++) {
            if (sticking > 0) glide(b, n, r, s, 1);
            else glide(b, n, r, s, 0);
            for (int j = 0; j < n; j++)
                if (b[ROW_eventful + j] != 0.0) sticking += follow(b, j, r, s, (double)(substep + 1) * s->physics_dt);
        }
        for (int j = 0; j < n; j++) {
            const int active = b[ROW_active + j] != 0.0;
            const double share = active ? 1.0 : 0.0, weight = (b[ROW_M + j] + r.m) * r.g;
            const double moved = b[ROW_x + j] - b[ROW_before_x + j], energy = b[ROW_energy + j], u = b[ROW_torque + j];
            const double progress = 100.0 * moved, cost = -s->energy_weight * energy;
            const double penalty = b[ROW_termination + j] != 0.0 ? -s->termination_penalty : 0.0;
            b[ROW_reward + j] = active ? progress + cost + penalty : 0.0;
            b[ROW_reward_progress + j] = active ? progress : b[ROW_reward_progress + j];
            b[ROW_reward_energy + j] = active ? cost : b[ROW_reward_energy + j];
            b[ROW_reward_termination + j] = active ? penalty : b[ROW_reward_termination + j];
            b[ROW_steps + j] += share;
            b[ROW_duration + j] += share * b[ROW_elapsed + j];
            b[ROW_torque_squared + j] += share * b[ROW_elapsed + j] * u * u;
            b[ROW_episode_energy + j] += share * energy;
            b[ROW_weight_distance + j] += share * weight * moved;
            const double smallest = smaller(b[ROW_smallest_normal_ratio + j], b[ROW_normal_force + j] / weight);
            b[ROW_smallest_normal_ratio + j] = active ? smallest : b[ROW_smallest_normal_ratio + j];
        }
        for (int j = 0; j < n; j++) {
            if (b[ROW_active + j] == 0.0) continue;
            float *o = observations + 5 * (block * LANES + j);
            o[0] = (float)clip(b[ROW_theta + j], s->theta_limit);
            o[1] = (float)clip(b[ROW_theta_dot + j], s->theta_dot_bound);
            o[2] = (float)clip(b[ROW_x_dot + j], s->x_dot_bound);
            o[3] = b[ROW_x_dot + j] == 0.0 ? 1.0f : 0.0f;
            o[4] = (float)b[ROW_action + j];
        }
    }
}
