#include "sensor_rt/scene/bsdf/subsurface.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/random.h"
#include "sensor_rt/geometry/recent.h"
#include "sensor_rt/scene/bsdf/ggx.h"

namespace sensor_rt {
namespace {

constexpr std::uint32_t kWalks = 16384;
constexpr int kLongest = 4096;   ///< events of a walk; the light of longer ones is lost
constexpr double kFaint = 1e-4;  ///< weight below which a walk ends
constexpr int kDepths = 12;      ///< classes of depth
constexpr int kPerOctave = 3;    ///< classes of displacement
constexpr int kDisplacements = 40;
constexpr double kNarrowest = 0.02;  ///< mean free paths: lower limit of the second class of displacement
constexpr int kFitRounds = 200;

/// A random walk in the half-space below z = 0, lengths in mean free paths, from the first point of
/// scattering on. Depths are positive.
class Walk {
 public:
  Walk(std::uint32_t number, const Subsurface& medium) : medium_(medium), number_(number) {
    position_ = {0.0, 0.0, -std::log(draw()[0])};
  }

  const Eigen::Vector3d& position() const { return position_; }

  /// Moves to the next point of scattering; false when the light leaves.
  bool advance() {
    const std::array<double, 3> u = draw();
    const double z = 2.0 * u[0] - 1.0;
    const double across = std::sqrt(1.0 - z * z);
    Eigen::Vector3d direction(across * std::cos(2.0 * M_PI * u[1]), across * std::sin(2.0 * M_PI * u[1]), z);
    position_ += -std::log(u[2]) * direction;
    if (position_.z() > 0.0) return true;
    if (draw()[0] < medium_.transmission_from_inside(-z)) return false;
    position_.z() = -position_.z();  // total or partial reflection
    return true;
  }

 private:
  std::array<double, 3> draw() {
    const auto bits = philox4x32({number_, count_++, 0u, 0xB370Fu}, {0x5EEDu, 0u});
    return {static_cast<double>(uniform01(bits[0])), static_cast<double>(uniform01(bits[1])),
            static_cast<double>(uniform01(bits[2]))};
  }

  const Subsurface& medium_;
  std::uint32_t number_;
  std::uint32_t count_ = 0;
  Eigen::Vector3d position_;
};

/// Class of a depth: two for each octave.
std::size_t depth_class(double depth) {
  const double octave = std::log2(std::max(depth, 1e-9) / 0.125);
  return static_cast<std::size_t>(std::clamp(static_cast<int>(std::floor(2.0 * octave)), 0, kDepths - 1));
}

std::size_t displacement_class(double displacement) {
  const double octave = std::log2(std::max(std::abs(displacement), 1e-9) / kNarrowest);
  const int number = 1 + static_cast<int>(std::floor(kPerOctave * octave));
  return static_cast<std::size_t>(std::clamp(number, 0, kDisplacements - 1));
}

/// Weight and sums of the walks of a class.
struct Bin {
  double weight = 0.0;
  double displacement2 = 0.0;
};

/// Weights and depths of all classes.
struct Histogram {
  std::vector<Bin> bins = std::vector<Bin>(kDepths * kDepths * kDisplacements);
  std::array<double, kDepths> weight{};
  std::array<double, kDepths> depth{};

  Bin& at(std::size_t first, std::size_t last, std::size_t displacement) {
    return bins[(first * kDepths + last) * kDisplacements + displacement];
  }
  const Bin& at(std::size_t first, std::size_t last, std::size_t displacement) const {
    return bins[(first * kDepths + last) * kDisplacements + displacement];
  }
};

/// A part is a Gaussian of the displacement, and in a range of the sum of both depths: where the displacement
/// is small, the distribution of the depths gives f its shape.
struct PartClass {
  std::size_t gaussian;
  double up_to;  ///< sum of the depths, mean free paths
};
constexpr double kAnyDepth = 1e9;
constexpr std::array<PartClass, Subsurface::kParts> kClasses{{{0, 0.3},
                                                              {0, 0.8},
                                                              {0, 2.0},
                                                              {0, kAnyDepth},
                                                              {1, 0.8},
                                                              {1, kAnyDepth},
                                                              {2, kAnyDepth},
                                                              {3, kAnyDepth},
                                                              {4, kAnyDepth},
                                                              {5, kAnyDepth}}};
constexpr std::size_t kGaussians = 6;

std::size_t class_of(std::size_t gaussian, double depths) {
  std::size_t part = 0;
  while (kClasses[part].gaussian != gaussian || depths > kClasses[part].up_to) ++part;
  return part;
}

/// Shares of the classes of displacement in Gaussians around zero, by expectation maximisation.
using Shares = std::array<std::array<double, kGaussians>, kDisplacements>;

Shares fit_gaussians(const std::array<Bin, kDisplacements>& classes) {
  std::array<double, kGaussians> weight{};
  std::array<double, kGaussians> variance{};
  double width = 0.05;
  for (std::size_t k = 0; k < kGaussians; ++k, width *= 3.0) {
    weight[k] = 1.0 / kGaussians;
    variance[k] = width * width;
  }
  Shares shares{};
  for (int round = 0; round < kFitRounds; ++round) {
    std::array<double, kGaussians> sum{};
    std::array<double, kGaussians> sum2{};
    for (std::size_t d = 0; d < kDisplacements; ++d) {
      if (!(classes[d].weight > 0.0)) continue;
      const double x2 = classes[d].displacement2 / classes[d].weight;
      double total = 0.0;
      for (std::size_t k = 0; k < kGaussians; ++k) {
        shares[d][k] = weight[k] / std::sqrt(variance[k]) * std::exp(-0.5 * x2 / variance[k]) + 1e-300;
        total += shares[d][k];
      }
      for (std::size_t k = 0; k < kGaussians; ++k) {
        shares[d][k] /= total;
        sum[k] += shares[d][k] * classes[d].weight;
        sum2[k] += shares[d][k] * classes[d].displacement2;
      }
    }
    for (std::size_t k = 0; k < kGaussians; ++k) {
      weight[k] = std::max(sum[k], 1e-12);
      variance[k] = std::max(sum2[k] / weight[k], 1e-6);
    }
  }
  return shares;
}

/// Returns what random walks meet whose light leaves along the normal.
Histogram walked(const Subsurface& medium) {
  Histogram seen;
  for (std::uint32_t number = 0; number < kWalks; ++number) {
    Walk walk(number, medium);
    const double first = walk.position().z();
    double weight = medium.albedo();
    int events = 1;
    do {
      const Eigen::Vector3d& at = walk.position();
      const double leaves = weight * std::exp(-at.z());
      for (const double displacement : {at.x(), at.y()}) {
        Bin& bin = seen.at(depth_class(first), depth_class(at.z()), displacement_class(displacement));
        bin.weight += leaves;
        bin.displacement2 += leaves * displacement * displacement;
      }
      for (const double depth : {first, at.z()}) {
        seen.weight[depth_class(depth)] += leaves;
        seen.depth[depth_class(depth)] += leaves * depth;
      }
      weight *= medium.albedo();
    } while (weight > kFaint && ++events <= kLongest && walk.advance());
  }
  for (std::size_t d = 0; d < kDepths; ++d) seen.depth[d] /= std::max(seen.weight[d], 1e-300);
  return seen;
}
/// Returns the moments of all parts by the cosines of refraction of source and viewer.
std::array<Subsurface::Moments, Subsurface::kParts> moments_of(const Histogram& seen, const Shares& shares,
                                                               double from, double towards) {
  std::array<Subsurface::Moments, Subsurface::kParts> parts{};
  double total = 0.0;
  for (std::size_t k = 0; k < kGaussians; ++k) {
    for (std::size_t a = 0; a < kDepths; ++a) {
      for (std::size_t b = 0; b < kDepths; ++b) {
        const double first = seen.depth[a];
        const double last = seen.depth[b];
        const double factor = std::exp(-first * (1.0 / from - 1.0) - last * (1.0 / towards - 1.0));
        double weight = 0.0;
        double displacement2 = 0.0;
        for (std::size_t d = 0; d < kDisplacements; ++d) {
          const Bin& bin = seen.at(a, b, d);
          weight += factor * shares[d][k] * bin.weight;
          displacement2 += factor * shares[d][k] * bin.displacement2;
        }
        Subsurface::Moments& part = parts[class_of(k, first + last)];
        total += weight;
        part.share += weight;
        part.depth[0] += weight * first;
        part.depth[1] += weight * last;
        part.covariance[0] += weight * first * first;
        part.covariance[1] += weight * last * last;
        part.covariance[2] += weight * first * last;
        part.spread += displacement2;
      }
    }
  }
  for (Subsurface::Moments& part : parts) {
    const double weight = std::max(part.share, 1e-300);
    for (double& value : part.depth) value /= weight;
    for (double& value : part.covariance) value /= weight;
    part.covariance[0] -= part.depth[0] * part.depth[0];
    part.covariance[1] -= part.depth[1] * part.depth[1];
    part.covariance[2] -= part.depth[0] * part.depth[1];
    part.spread /= weight;
    part.share /= total;
  }
  return parts;
}

}  // namespace

Subsurface::Subsurface(double reflectance, double scattering, double refractive_index,
                       const CosineTable& interface)
    : refractive_index_(refractive_index), interface_(interface) {
  find_albedo(reflectance);
  mean_free_path_ = albedo_ / scattering;
  find_moments();
}

double Subsurface::transmission_from_inside(double cosine) const {
  const double sine2 = (1.0 - cosine * cosine) * refractive_index_ * refractive_index_;
  return sine2 < 1.0 ? transmission(std::sqrt(1.0 - sine2)) : 0.0;
}

/// Finds the albedo with which the given share of the light leaves again: the mean of albedo^events.
void Subsurface::find_albedo(double reflectance) {
  std::vector<std::uint32_t> walks(kLongest + 1);  // by number of events
  for (std::uint32_t number = 0; number < kWalks; ++number) {
    Walk walk(number, *this);
    int events = 1;
    while (events <= kLongest && walk.advance()) ++events;
    if (events <= kLongest) ++walks[static_cast<std::size_t>(events)];
  }
  double low = 0.0;
  double high = 1.0;
  for (int round = 0; round < 60; ++round) {
    albedo_ = 0.5 * (low + high);
    double sum = 0.0;
    double power = 1.0;
    for (const std::uint32_t count : walks) {
      sum += power * count;
      power *= albedo_;
    }
    (sum < reflectance * kWalks ? low : high) = albedo_;
  }
}

void Subsurface::find_moments() {
  const Histogram seen = walked(*this);
  std::array<Bin, kDisplacements> classes{};
  for (std::size_t i = 0; i < seen.bins.size(); ++i) {
    classes[i % kDisplacements].weight += seen.bins[i].weight;
    classes[i % kDisplacements].displacement2 += seen.bins[i].displacement2;
  }
  const Shares shares = fit_gaussians(classes);
  const auto cosine = [this](std::size_t node) {
    const double share = (static_cast<double>(node) + 0.5) / kCosines;  // at grazing angles none is left
    return smallest_cosine() + (1.0 - smallest_cosine()) * share;
  };
  const double steepest = std::sqrt(1.0 / (smallest_cosine() * smallest_cosine() + 1e-2) - 1.0);
  for (std::size_t i = 0; i < kCosines * kCosines; ++i) {
    moments_.push_back(moments_of(seen, shares, cosine(i / kCosines), cosine(i % kCosines)));
    for (std::size_t k = 0; k < kParts; ++k) {
      const Moments& part = moments_[i][k];
      const double slanted = steepest * (part.depth[0] + part.depth[1] + std::sqrt(part.covariance[0]) +
                                         std::sqrt(part.covariance[1]));
      reach_[k] = std::max(reach_[k], mean_free_path_ * (slanted + std::sqrt(part.spread)));
    }
  }
}

Subsurface::Part Subsurface::part(int number, const Direction& from, const Direction& towards) const {
  const auto position = [this](double cosine, std::size_t& node) {
    const double share = (cosine - smallest_cosine()) / (1.0 - smallest_cosine() + 1e-12);
    const double at = std::clamp(share * kCosines - 0.5, 0.0, kCosines - 1.0);
    node = std::min(static_cast<std::size_t>(at), static_cast<std::size_t>(kCosines - 2));
    return at - static_cast<double>(node);
  };
  std::size_t i = 0;
  std::size_t j = 0;
  const double s = position(from.cosine, i);
  const double t = position(towards.cosine, j);
  const double a = -from.tangent;  // light from one side enters towards the other
  const double b = towards.tangent;
  Part sum{0.0, 0.0, 0.0};
  for (std::size_t corner = 0; corner < 4; ++corner) {
    const std::size_t p = corner / 2;
    const std::size_t q = corner % 2;
    const double weight = (p == 1 ? s : 1.0 - s) * (q == 1 ? t : 1.0 - t);
    const Moments& m = moments_[(i + p) * kCosines + j + q][static_cast<std::size_t>(number)];
    sum.share += weight * m.share;
    sum.mean += weight * (a * m.depth[0] + b * m.depth[1]);
    sum.variance += weight * (m.spread + a * a * m.covariance[0] + b * b * m.covariance[1] +
                              2.0 * a * b * m.covariance[2]);
  }
  return {sum.share, mean_free_path_ * sum.mean, mean_free_path_ * mean_free_path_ * sum.variance};
}

std::shared_ptr<const Subsurface> Subsurface::shared(double reflectance, double scattering,
                                                     double refractive_index, double roughness,
                                                     const CosineTable& interface) {
  constexpr std::size_t kKept = 16;
  static Recent<std::array<double, 4>, Subsurface> recent(kKept);
  return recent.get({reflectance, scattering, refractive_index, roughness},
                    [&] { return Subsurface(reflectance, scattering, refractive_index, interface); });
}

}  // namespace sensor_rt
