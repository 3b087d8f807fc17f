// Brushed, milled or turned metal.
#include <algorithm>
#include <cmath>
#include <utility>

#include "sensor_rt/scene/bsdf/ggx.h"
#include "sensor_rt/scene/bsdf/microfacet_bsdf.h"
#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {
namespace {

/// GGX with two widths (Heitz, "Understanding the masking-shadowing function in microfacet-based BRDFs",
/// 2014). Directions have x along the grooves, y across them and z along the normal.
struct GroovedGgx {
  double along;
  double across;

  /// Returns the root in Smith's masking function, 1 for a smooth surface seen from above.
  double root(const Eigen::Vector3d& w) const {
    return std::sqrt(along * along * w.x() * w.x() + across * across * w.y() * w.y() + w.z() * w.z());
  }
  double density(const Eigen::Vector3d& half) const {
    const double x = half.x() / along;
    const double y = half.y() / across;
    const double d = x * x + y * y + half.z() * half.z();
    return 1.0 / (M_PI * along * across * d * d);
  }
  double brdf(const Eigen::Vector3d& a, const Eigen::Vector3d& b) const {
    return 0.5 * density((a + b).normalized()) / (a.z() * root(b) + b.z() * root(a));
  }
  /// Samples visible normals as sample_ggx.
  Eigen::Vector3d sample(const Eigen::Vector3d& from, double u1, double u2) const {
    const Eigen::Vector3d stretched =
        Eigen::Vector3d(along * from.x(), across * from.y(), from.z()).normalized();
    const double phi = 2.0 * M_PI * u1;
    const double z = (1.0 - u2) * (1.0 + stretched.z()) - stretched.z();
    const double radius = std::sqrt(std::clamp(1.0 - z * z, 0.0, 1.0));
    const Eigen::Vector3d half =
        stretched + Eigen::Vector3d(radius * std::cos(phi), radius * std::sin(phi), z);
    const Eigen::Vector3d facet = Eigen::Vector3d(along * half.x(), across * half.y(), half.z()).normalized();
    return 2.0 * from.dot(facet) * facet - from;
  }
  double pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& towards) const {
    return 0.5 * density((from + towards).normalized()) / (from.z() + root(from));
  }
  /// Returns the albedo of single scattering for a Fresnel reflectance by cosine.
  template <typename Fresnel>
  double albedo(const Eigen::Vector3d& from, const Fresnel& fresnel) const {
    constexpr int kSteps = 48;
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      for (int j = 0; j < kSteps; ++j) {
        const Eigen::Vector3d out = sample(from, (i + 0.5) / kSteps, (j + 0.5) / kSteps);
        if (!(out.z() > 0.0)) continue;
        const double facing = std::sqrt(std::max(0.0, 0.5 * (1.0 + from.dot(out))));
        // G2 / G1
        sum += fresnel(facing) * out.z() * (from.z() + root(from)) /
               (from.z() * root(out) + out.z() * root(from));
      }
    }
    return sum / (kSteps * kSteps);
  }
};

/// Function of cosine and azimuth of incidence with the symmetry of grooves, tabulated over the share of x²
/// in x² + y².
class DirectionTable {
 public:
  template <typename Function>
  explicit DirectionTable(const Function& function) {
    for (int k = 0; k < kNodes; ++k) {
      const double share = static_cast<double>(k) / (kNodes - 1);
      by_share_.emplace_back([&](double cosine) {
        const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
        return function(Eigen::Vector3d(sine * std::sqrt(share), sine * std::sqrt(1.0 - share), cosine));
      });
    }
  }

  double at(const Eigen::Vector3d& w) const {
    const double tangential = w.x() * w.x() + w.y() * w.y();
    const double position = tangential > 0.0 ? w.x() * w.x() / tangential * (kNodes - 1) : 0.0;
    const auto before = static_cast<std::size_t>(std::min(position, kNodes - 2.0));
    const double fraction = position - static_cast<double>(before);
    return (1.0 - fraction) * by_share_[before].at(w.z()) + fraction * by_share_[before + 1].at(w.z());
  }
  /// Returns the mean over the azimuth.
  double at(double cosine) const {
    return over_azimuth([&](const CosineTable& table) { return table.at(cosine); });
  }
  /// Returns the mean over azimuth and cosine, weighted by the cosine.
  double mean() const {
    return over_azimuth([](const CosineTable& table) { return table.mean(); });
  }

 private:
  static constexpr int kNodes = 5;

  template <typename Value>
  double over_azimuth(const Value& value) const {
    constexpr int kSteps = 64;
    std::vector<double> nodes;
    for (const CosineTable& table : by_share_) nodes.push_back(value(table));
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const double c = std::cos(0.5 * M_PI * (i + 0.5) / kSteps);
      const double position = c * c * (kNodes - 1);
      const auto before = static_cast<std::size_t>(std::min(position, kNodes - 2.0));
      const double fraction = position - static_cast<double>(before);
      sum += (1.0 - fraction) * nodes[before] + fraction * nodes[before + 1];
    }
    return sum / kSteps;
  }

  std::vector<CosineTable> by_share_;
};

/// Rough metal with a lobe that is wide across the grooves and narrow along them. What single scattering
/// loses is added as in the isotropic model, see MicrofacetBsdf.
class GroovedConductor : public Bsdf {
 public:
  explicit GroovedConductor(const Material& material)
      : lobe_{material.roughness_along, material.roughness},
        reflectance_(material.reflectance),
        single_(
            [this](const Eigen::Vector3d& from) { return lobe_.albedo(from, [](double) { return 1.0; }); }),
        coloured_([this](const Eigen::Vector3d& from) {
          return lobe_.albedo(from, [this](double facing) { return schlick_fresnel(facing, reflectance_); });
        }),
        mean_single_(single_.mean()) {
    constexpr double kTiny = 1e-9;
    const double lost = 1.0 - mean_single_;
    if (lost > kTiny) {
      const double mean_fresnel = reflectance_ + (1.0 - reflectance_) / 21.0;
      rest_ = mean_fresnel * mean_fresnel * mean_single_ / (1.0 - mean_fresnel * lost) / lost;
    }
  }

  double pi_brdf(const SurfaceFrame& surface, const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b) const override {
    const TangentFrame frame = tangent_frame(surface);
    return local_pi_brdf(frame.to_local(a), frame.to_local(b));
  }

  /// Mean over the azimuth.
  double albedo(double cosine) const override {
    return coloured_.at(cosine) + rest_ * (1.0 - single_.at(cosine)) * (1.0 - mean_single_);
  }

  BsdfSample sample(const SurfaceFrame& surface, const Eigen::Vector3d& from, double u0, double u1,
                    double u2) const override {
    BsdfSample result;
    const TangentFrame frame = tangent_frame(surface);
    const Eigen::Vector3d local = frame.to_local(from);
    if (!(local.z() > 0.0)) return result;
    const Eigen::Vector3d out = u0 < lobe_share(local) ? lobe_.sample(local, u1, u2) : sample_cosine(u1, u2);
    if (!(out.z() > 0.0)) return result;
    result.towards = frame.to_world(out);
    result.pdf = local_pdf(local, out);
    if (result.pdf > 0.0) result.weight = local_pi_brdf(local, out) * (out.z() / M_PI) / result.pdf;
    return result;
  }

  double pdf(const SurfaceFrame& surface, const Eigen::Vector3d& from,
             const Eigen::Vector3d& towards) const override {
    const TangentFrame frame = tangent_frame(surface);
    const Eigen::Vector3d local = frame.to_local(from);
    const Eigen::Vector3d out = frame.to_local(towards);
    return local.z() > 0.0 && out.z() > 0.0 ? local_pdf(local, out) : 0.0;
  }

 private:
  static TangentFrame tangent_frame(const SurfaceFrame& surface) {
    return surface.along.isZero() ? TangentFrame(surface.normal)
                                  : TangentFrame(surface.normal, surface.along);
  }
  double local_pi_brdf(const Eigen::Vector3d& a, const Eigen::Vector3d& b) const {
    if (!(a.z() > 0.0) || !(b.z() > 0.0)) return 0.0;
    const double facing = (a + b).normalized().dot(a);
    return rest_ * (1.0 - single_.at(a)) * (1.0 - single_.at(b)) +
           M_PI * lobe_.brdf(a, b) * schlick_fresnel(facing, reflectance_);
  }
  /// Returns the probability of sampling the lobe.
  double lobe_share(const Eigen::Vector3d& from) const {
    constexpr double kTiny = 1e-9;
    const double single = single_.at(from);
    const double rest = rest_ * (1.0 - single) * (1.0 - mean_single_);
    return std::clamp(single / std::max(single + rest, kTiny), 0.1, 0.99);
  }
  double local_pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& out) const {
    const double share = lobe_share(from);
    return share * lobe_.pdf(from, out) + (1.0 - share) * out.z() / M_PI;
  }

  GroovedGgx lobe_;
  double reflectance_;
  DirectionTable single_;    ///< albedo of single scattering on a perfect reflector
  DirectionTable coloured_;  ///< the same with Fresnel
  double mean_single_;
  double rest_ = 0.0;
};

}  // namespace

extern const BsdfModel bsdf_grooved_conductor{"grooved_conductor", 0.01, make_bsdf_of<GroovedConductor>,
                                              true};

}  // namespace sensor_rt
