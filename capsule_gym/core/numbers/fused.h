// a * b + c, rounded once, where the processor has no instruction for it.
//
// Exact products and sums, the last but one rounded to odd (Boldo and Melquiond, "Emulation of a
// FMA and correctly rounded sums", 2008). The errors of p = a b and of the sums are exact by the
// splits of Veltkamp and Dekker and by Knuth's sums. Where a size is not between 2^-623 and 2^577,
// an intermediate result could over- or underflow. The sum is rounded to odd without a branch,
// since no processor predicts it; `const`: equal calls are made once.
static inline int NAME_moderate(double x) {
  unsigned long long word;
  __builtin_memcpy(&word, &x, 8);
  return (word >> 52 & 2047) - 400 < 1200;
}

static __attribute__((noinline, const, unused)) double NAME_fused(double a, double b, double c) {
  double p = a * b;
  if (!(NAME_moderate(a) & NAME_moderate(b) & NAME_moderate(c) & NAME_moderate(p))) {
    if (a == 0.0 || b == 0.0 || (c == 0.0 && NAME_moderate(p))) return p + c;
    return __builtin_fma(a, b, c);
  }
  double a_h = a * 134217729.0;
  double b_h = b * 134217729.0;
  a_h = a_h - (a_h - a);
  b_h = b_h - (b_h - b);
  double a_l = a - a_h;
  double b_l = b - b_h;
  double rest = ((a_h * b_h - p) + a_h * b_l + a_l * b_h) + a_l * b_l;
  double t = c + rest;
  double t_0 = t - c;
  double t_error = (c - (t - t_0)) + (rest - t_0);
  double v = p + t;
  double v_0 = v - p;
  double v_error = (p - (v - v_0)) + (t - v_0);
  double z = t_error + v_error;
  double z_0 = z - t_error;
  double z_error = (t_error - (z - z_0)) + (v_error - z_0);
  unsigned long long word;
  __builtin_memcpy(&word, &z, sizeof(z));
  unsigned long long inexact_and_even = (z_error != 0.0) & ~word & 1;
  int away_from_zero = (z_error > 0.0) == (z > 0.0);
  word += (away_from_zero ? 1 : -1) * inexact_and_even;
  __builtin_memcpy(&z, &word, sizeof(z));
  return v + z;
}
