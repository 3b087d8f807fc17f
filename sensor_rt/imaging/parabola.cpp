// Stripe centre as the vertex of a parabola: through the three highest pixels, or by weighted least squares
// through the logarithm of the signal, which is a parabola for a Gaussian.
#include <cmath>

#include "sensor_rt/imaging/column_window.h"

namespace sensor_rt {
namespace {

constexpr int kLogReach = 4;        // rows to either side of the summit
constexpr double kMinSignal = 2.0;  // noise standard deviations: the logarithm of smaller signals is biased
constexpr double kMinShare = 0.02;  // fraction of the highest pixel, for the same reason
constexpr double kLogModelError = 0.01;  // relative deviation of a real stripe from the model

/// Solves the weighted normal equations of z = c0 + c1 t + c2 t²; returns the vertex -c1 / (2 c2) with its
/// variance.
struct LogParabola {
  double m[5] = {};  // sums of w t^k
  double r[3] = {};  // sums of w t^k z
  int rows = 0;

  void add(double t, double z, double w) {
    double power = w;
    for (int k = 0; k < 5; ++k, power *= t) {
      m[k] += power;
      if (k < 3) r[k] += power * z;
    }
    ++rows;
  }

  double minor(int a, int b, int c, int d) const { return m[a] * m[d] - m[b] * m[c]; }

  /// Rows of the inverse (times the determinant) that give c1 and c2.
  void solve(double (&to_c1)[3], double (&to_c2)[3]) const {
    const double determinant = m[0] * minor(2, 3, 3, 4) - m[1] * minor(1, 3, 2, 4) + m[2] * minor(1, 2, 2, 3);
    to_c1[0] = -minor(1, 3, 2, 4) / determinant;
    to_c1[1] = minor(0, 2, 2, 4) / determinant;
    to_c1[2] = -minor(0, 2, 1, 3) / determinant;
    to_c2[0] = minor(1, 2, 2, 3) / determinant;
    to_c2[1] = -minor(0, 2, 1, 3) / determinant;
    to_c2[2] = minor(0, 1, 1, 2) / determinant;
  }
};

double dot(const double (&a)[3], const double (&b)[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void locate_one(const ColumnWindow& w, const Candidate& c, StripeFit& fit) {
  const double top = summit(w);
  const double highest = w.at(static_cast<int>(std::lround(top)));
  LogParabola p;
  double weights[kWindowRows];
  for (int i = 0; i < w.count; ++i) {
    const double s = w.signal[i];
    const bool usable =
        !w.clipped[i] && s > kMinShare * highest && s * s > kMinSignal * kMinSignal * w.variance[i];
    weights[i] = usable ? 1.0 / (w.variance[i] / (s * s) + kLogModelError * kLogModelError) : 0.0;
    if (usable) p.add(i - top, std::log(s), weights[i]);
  }
  double to_c1[3];
  double to_c2[3];
  p.solve(to_c1, to_c2);
  const double c1 = dot(to_c1, p.r);
  const double c2 = dot(to_c2, p.r);
  double variance = 0.0;
  for (int i = 0; i < w.count; ++i) {
    if (weights[i] == 0.0) continue;
    const double powers[3] = {1.0, i - top, (i - top) * (i - top)};
    const double influence =
        weights[i] * (-dot(to_c1, powers) / (2.0 * c2) + c1 * dot(to_c2, powers) / (2.0 * c2 * c2));
    variance += influence * influence * w.variance[i] / (w.signal[i] * w.signal[i]);
  }
  const bool is_summit = p.rows >= 3 && c2 < 0.0;
  set_row(w, c, is_summit ? top - c1 / (2.0 * c2) : NAN, variance, fit);
}

}  // namespace

void locate_log_parabola(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                         std::size_t count, StripeFit* fits) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    measure_moments(image, noise, c, fits[k]);
    const ColumnWindow wide = gather(image, noise, c, kWindowRows / 2);
    Candidate middle = c;
    middle.row = static_cast<float>(wide.first + summit(wide));
    int flank = 0;  // clipped rows are not counted among the four on either side
    for (int i = 0; i < wide.count; ++i) flank += wide.clipped[i] ? 1 : 0;
    locate_one(gather(image, noise, middle, kLogReach + flank / 2), c, fits[k]);
  }
}

void locate_parabola(ImageRows image, const PixelNoise& noise, const Candidate* candidates, std::size_t count,
                     StripeFit* fits) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    const ColumnWindow w = measure_moments(image, noise, c, fits[k]);
    const int top = static_cast<int>(std::lround(summit(w)));
    const double a = w.at(top - 1);
    const double b = w.at(top);
    const double d = w.at(top + 1);
    const double bend = a - 2.0 * b + d;
    // d row / d (a, b, d)
    const double shift = 0.5 * (a - d) / bend;
    const double influence[3] = {(0.5 - shift) / bend, 2.0 * shift / bend, (-0.5 - shift) / bend};
    double variance = 0.0;
    for (int j = 0; j < 3; ++j) {
      const int i = top - 1 + j;
      if (i >= 0 && i < w.count) variance += influence[j] * influence[j] * w.variance[i];
    }
    const bool inside = top > 0 && top + 1 < w.count && bend < 0.0;
    set_row(w, c, inside ? top + shift : NAN, variance, fits[k]);
  }
}

}  // namespace sensor_rt
