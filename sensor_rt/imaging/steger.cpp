// Steger's detector of curvilinear structures (PAMI 20, 1998): the ridge of the image smoothed by a Gaussian,
// from its first and second derivatives. It is the only detector that uses neighbouring columns: it averages
// along the stripe and blurs changes within its kernel.
//
// The kernel is centred on the sub-pixel row and moved until the ridge lies at its centre, where the
// second-order expansion is accurate. The row is the intersection of the ridge with the column.
#include <algorithm>
#include <cmath>

#include "sensor_rt/imaging/column_window.h"

namespace sensor_rt {
namespace {

constexpr double kMinRidgeSigma = 1.0;  // px
constexpr double kMaxRidgeSigma = 6.0;
constexpr int kSteps = 8;
constexpr double kConvergedStep = 1e-3;  // px
constexpr double kSteepest = 0.25;       // smallest component of the ridge's normal along the column
constexpr int kMaxReach = 18;            // three times the widest kernel
constexpr int kMaxTaps = 2 * kMaxReach + 2;

/// Gaussian and its first two derivatives with respect to the centre, at integer taps.
struct Kernel {
  int first = 0;
  int count = 0;
  double g[kMaxTaps];
  double d1[kMaxTaps];
  double d2[kMaxTaps];

  Kernel(double centre, double s) {
    first = static_cast<int>(std::ceil(centre - 3.0 * s));
    count = std::min(kMaxTaps, static_cast<int>(std::floor(centre + 3.0 * s)) - first + 1);
    for (int i = 0; i < count; ++i) {
      const double z = (first + i - centre) / s;
      g[i] = std::exp(-0.5 * z * z);
      d1[i] = z / s * g[i];
      d2[i] = (z * z - 1.0) / (s * s) * g[i];
    }
  }
};

/// Derivatives of the smoothed image.
struct Derivatives {
  double x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
};

class Ridge {
 public:
  Ridge(ImageRows image, const PixelNoise& noise, const Candidate& c)
      : image_(image),
        noise_(noise),
        c_(c),
        scale_(std::clamp(static_cast<double>(c.width), kMinRidgeSigma, kMaxRidgeSigma)),
        across_(0.0, scale_) {}

  /// Row of the ridge, or NaN; `variance` in px².
  double find(double& variance) {
    double row = static_cast<double>(c_.row);
    for (int step = 0; step < kSteps; ++step) {
      const Kernel down(row, scale_);
      const Derivatives d = derive(down);
      // Normal of the ridge: eigenvector of the eigenvalue of largest modulus.
      const double angle = 0.5 * std::atan2(2.0 * d.xy, d.xx - d.yy);
      double nx = std::cos(angle);
      double ny = std::sin(angle);
      double bend = d.xx * nx * nx + 2.0 * d.xy * nx * ny + d.yy * ny * ny;
      const double other = d.xx + d.yy - bend;
      if (std::fabs(other) > std::fabs(bend)) {
        std::swap(nx, ny);
        nx = -nx;
        bend = other;
      }
      if (bend >= 0.0 || std::fabs(ny) < kSteepest) return NAN;
      const double shift = -(d.x * nx + d.y * ny) / (bend * ny);
      row += std::clamp(shift, -scale_, scale_);
      if (std::fabs(shift) < kConvergedStep) {
        variance = propagate(down, nx, ny, bend);
        return row;
      }
    }
    return NAN;
  }

 private:
  int column(int i) const { return std::clamp(c_.column + across_.first + i, 0, image_.width - 1); }
  int row(const Kernel& down, int j) const { return std::clamp(down.first + j, 0, image_.height - 1); }
  bool is_own(const Kernel& down, int j) const {
    return down.first + j >= c_.lower_limit && down.first + j <= c_.upper_limit;
  }

  Derivatives derive(const Kernel& down) const {
    Derivatives d;
    for (int i = 0; i < across_.count; ++i) {
      double g = 0.0;
      double d1 = 0.0;
      double d2 = 0.0;
      for (int j = 0; j < down.count; ++j) {
        if (!is_own(down, j)) continue;
        const double value =
            image_.at(row(down, j), column(i)) - static_cast<double>(c_.background_at(down.first + j));
        g += value * down.g[j];
        d1 += value * down.d1[j];
        d2 += value * down.d2[j];
      }
      d.x += across_.d1[i] * g;
      d.xx += across_.d2[i] * g;
      d.y += across_.g[i] * d1;
      d.xy += across_.d1[i] * d1;
      d.yy += across_.g[i] * d2;
    }
    return d;
  }

  double propagate(const Kernel& down, double nx, double ny, double bend) const {
    const auto relative = static_cast<double>(noise_.relative_of_sums());
    double variance = 0.0;
    for (int i = 0; i < across_.count; ++i) {
      for (int j = 0; j < down.count; ++j) {
        if (!is_own(down, j)) continue;
        const double value =
            image_.at(row(down, j), column(i)) - static_cast<double>(c_.background_at(down.first + j));
        const double light = std::max(0.0, value);
        const double influence =
            (across_.d1[i] * down.g[j] * nx + across_.g[i] * down.d1[j] * ny) / (bend * ny);
        variance +=
            influence * influence *
            (noise_.variance(value) + static_cast<double>(c_.light_variance) + relative * light * light);
      }
    }
    return variance;
  }

  ImageRows image_;
  const PixelNoise& noise_;
  const Candidate& c_;
  double scale_;
  Kernel across_;
};

}  // namespace

void locate_steger(ImageRows image, const PixelNoise& noise, const Candidate* candidates, std::size_t count,
                   StripeFit* fits) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    const ColumnWindow w = measure_moments(image, noise, c, fits[k]);
    double variance = 0.0;
    const double row = Ridge(image, noise, c).find(variance);
    set_row(w, c, row - w.first, variance, fits[k]);
  }
}

}  // namespace sensor_rt
