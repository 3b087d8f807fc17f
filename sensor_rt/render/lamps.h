// Light of lamps on surfaces in view.
#pragma once

#include <vector>

#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

/// Direct light of the scene's lamps.
class Lamps {
 public:
  explicit Lamps(const RenderPlan& plan);

  /// `views` must stay.
  void set(const ExposureViews& views) { views_ = &views; }
  bool any() const { return !views_->scene->lights().empty(); }

  /// Light sent to where a ray came from by the point it met, as irradiance on a white diffuse surface, with
  /// shadows. Areas are summed up over 16 pieces.
  double brightness(const SurfacePoint& at, const Reflection& reflection, std::size_t instant) const;

  /// What a random piece of lamp `number` adds to that, and the way to the piece, along which nothing may
  /// stand before 1.
  double sample(std::size_t number, const SurfacePoint& at, const Reflection& reflection, std::size_t instant,
                double u, double v, Eigen::Vector3d& way) const;

 private:
  double received(const LightPiece& piece, const SurfacePoint& at, const Reflection& reflection) const;

  const RenderPlan& plan_;
  const ExposureViews* views_ = nullptr;
};

}  // namespace sensor_rt
