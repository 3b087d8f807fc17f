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
  double pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& towards) const {
    return 0.5 * density((from + towards).normalized()) / (from.z() + root(from));
  }
  template <typename Fresnel>
  double albedo(const Eigen::Vector3d& from, const Fresnel& fresnel) const {
    const double root_from = root(from);
    const auto unshadowed = [&](const Eigen::Vector3d& out) {
      return out.z() * (from.z() + root_from) / (from.z() * root(out) + out.z() * root_from);
    };
    return ggx_albedo(from, along, across, unshadowed, fresnel);
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
    const Position at = position(tangential > 0.0 ? w.x() * w.x() / tangential : 0.0);
    return (1.0 - at.fraction) * by_share_[at.before].at(w.z()) +
           at.fraction * by_share_[at.before + 1].at(w.z());
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

  /// Between two nodes.
  struct Position {
    std::size_t before;
    double fraction;
  };

  static Position position(double share) {
    const double node = share * (kNodes - 1);
    const auto before = static_cast<std::size_t>(std::min(node, kNodes - 2.0));
    return {before, node - static_cast<double>(before)};
  }

  template <typename Value>
  double over_azimuth(const Value& value) const {
    constexpr int kSteps = 64;
    std::vector<double> nodes;
    for (const CosineTable& table : by_share_) nodes.push_back(value(table));
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const double c = std::cos(0.5 * M_PI * (i + 0.5) / kSteps);
      const Position at = position(c * c);
      sum += (1.0 - at.fraction) * nodes[at.before] + at.fraction * nodes[at.before + 1];
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
        mean_single_(single_.mean()),
        rest_(conductor_rest(reflectance_, mean_single_)) {}

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
    const Eigen::Vector3d out = u0 < share_of_lobe(local)
                                    ? sample_ggx(local, lobe_.along, lobe_.across, u1, u2)
                                    : sample_cosine(u1, u2);
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

  double lobe_width() const override { return std::min(lobe_.along, lobe_.across); }

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
  double share_of_lobe(const Eigen::Vector3d& from) const {
    const double single = single_.at(from);
    return lobe_share(single, rest_ * (1.0 - single) * (1.0 - mean_single_));
  }
  double local_pdf(const Eigen::Vector3d& from, const Eigen::Vector3d& out) const {
    const double share = share_of_lobe(from);
    return share * lobe_.pdf(from, out) + (1.0 - share) * out.z() / M_PI;
  }

  GroovedGgx lobe_;
  double reflectance_;
  DirectionTable single_;    ///< albedo of single scattering on a perfect reflector
  DirectionTable coloured_;  ///< the same with Fresnel
  double mean_single_;
  double rest_;
};

}  // namespace

extern const BsdfModel bsdf_grooved_conductor{"grooved_conductor", 0.01, make_bsdf_of<GroovedConductor>,
                                              true};

}  // namespace sensor_rt
