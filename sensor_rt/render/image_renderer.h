// Rendering: poses and light -> expected electrons per pixel.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/photons/splat_image.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/render/sparse_image.h"
#include "sensor_rt/render/stripe/laser_mesh.h"
#include "sensor_rt/render/stripe/stripe_image.h"

namespace sensor_rt {

/// Memory that a thread reuses from exposure to exposure, of any plan. Images do not depend on its content.
struct RenderBuffers {
  StripeSamples samples;
  LaserMesh mesh;
  std::vector<StripeImage> stripe;  ///< per camera
  std::vector<float> row_shares;
  LensBlur::Buffers blur;
  PoseTrack track;
  ExposureViews views;
  RowViews::Rows rows;
  std::vector<SplatImage> reflected;  ///< per camera: laser light reflected between surfaces
  std::vector<float> dense;
};

/// Renders one image per camera. Direct light depends on the poses of the exposure alone; an exposure without
/// motion gives the same bytes for any number of pose samples. Reflected light is computed from random paths
/// that depend on the seed and the frame number. With a rolling shutter the poses cover the time of all rows,
/// see RowViews, and there is no reflected light.
void render_light(const RenderPlan& plan, const Scene& scene, const Exposures& exposures,
                  std::size_t exposure, RenderBuffers& buffers, std::vector<SparseImage>& images);

}  // namespace sensor_rt
