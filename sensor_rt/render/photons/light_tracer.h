// Light tracing from the laser over reflecting surfaces to the cameras.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/photons/planar_mirrors.h"
#include "sensor_rt/render/photons/splat_image.h"

namespace sensor_rt {

/// Photons are emitted within the sheet and reflected; from the second surface on every hit is connected to
/// all cameras (light tracing, Arvo 1986; the first surface belongs to direct rendering), also via planar
/// mirrors. The contribution of a photon is spread over an image patch whose size follows from the pdf of its
/// directions: broad for diffuse light, a single pixel after mirrors. Without state.
class LightTracer {
 public:
  /// `views` must outlive it. `frame` selects the random numbers. `mirrors_first`: only light that hits a
  /// mirror first, not spread, as a complement to path tracing.
  LightTracer(const RenderPlan& plan, const ExposureViews& views, std::int64_t frame, bool mirrors_first);

  /// Adds electrons per second to one image per camera.
  void trace(std::vector<SplatImage>& images) const;

 private:
  struct Packet;

  void emit(Packet& packet, std::uint32_t first) const;
  void weight_first_hits(Packet& packet) const;
  bool reflect(Packet& packet, int depth) const;
  void blur(std::size_t camera, const Packet& packet, const Lanes3& points, double* column,
            double* row) const;
  void connect(const Packet& packet, std::vector<SplatImage>& images) const;
  void connect_by_mirrors(const Packet& packet, std::size_t camera, const Lanes3& seen,
                          std::vector<std::size_t>& chain, SplatImage& image) const;
  void splat(const Packet& packet, std::size_t camera, const Lanes3& seen,
             const std::vector<std::size_t>& chain, SplatImage& image) const;

  const RenderPlan& plan_;
  const ExposureViews& views_;
  std::int64_t frame_;
  bool mirrors_first_;
  std::uint32_t photons_;
  PlanarMirrors mirrors_;
};

}  // namespace sensor_rt
