// Numbers that follow from the bytes of the fuzzer.
#pragma once
#include <fuzzer/FuzzedDataProvider.h>

#include <cmath>

struct Input {
  FuzzedDataProvider bytes;

  bool flag() { return bytes.ConsumeBool(); }
  int whole(int low, int high) { return bytes.ConsumeIntegralInRange(low, high); }
  // Any number but NaN.
  double any() {
    auto word = bytes.ConsumeIntegral<unsigned long long>();
    double number = __builtin_bit_cast(double, word);
    return number == number ? number : 0.0;
  }
  double share() { return bytes.ConsumeIntegral<unsigned short>() / 65535.0; }

  // A number between the limits: often the usual one, a limit, or of any order of magnitude.
  double number(double usual, double low, double high) {
    switch (whole(0, 7)) {
      case 0:
        return low;
      case 1:
        return high;
      case 2:
        return std::fmin(std::fmax(any(), low), high);
      case 3:
        return low + share() * (high - low);
      case 4: {
        double size = std::exp2(whole(-40, 40)) * (1.0 + share());
        return std::fmin(std::fmax(flag() ? size : -size, low), high);
      }
      default:
        return std::fmin(std::fmax(usual * (0.5 + share()), low), high);
    }
  }
};
