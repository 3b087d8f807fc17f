// Precomputed data of a sensor for rendering, shared by all threads.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/optics/projector.h"
#include "sensor_rt/optics/sensor_model.h"
#include "sensor_rt/render/emitter/speckle_tile.h"
#include "sensor_rt/render/render_options.h"
#include "sensor_rt/render/sampling_pattern.h"
#include "sensor_rt/render/stripe/lens_blur.h"

namespace sensor_rt {

/// Options of a sensor and the kind of image to render.
struct RenderSettings : RenderOptions {
  SensorModel model;
  double quantum_efficiency = 0.0;
  bool laser_on = true;  ///< false: a background frame, taken directly after the one with the laser on
};

/// Extent of the sheet in standard deviations from its centre; the irradiance has dropped to 4e-5 of the
/// peak.
constexpr double kSheetReach = 4.5;

/// Samples of a pixel of one camera, the same in all pixels and padded to full packets.
struct CameraSamples {
  std::vector<double> column;  ///< px from the pixel centre
  std::vector<double> row;
  std::vector<double> lens_x;  ///< m from the lens centre, in the camera frame
  std::vector<double> lens_y;
  std::vector<Lanes3> viewpoints;  ///< ray origins per packet
};

/// A point of the lens of one camera, and where its point spread function displaces the light.
struct LensPoint {
  bool is_centre = true;                                ///< of the lens and of the point spread function
  Eigen::Vector2d in_camera = Eigen::Vector2d::Zero();  ///< m from the lens centre
  Eigen::Vector2d blur_px = Eigen::Vector2d::Zero();
  Eigen::Vector3d viewpoint = Eigen::Vector3d::Zero();  ///< in the reference frame
};

/// A point of the laser source and of every lens.
struct LatticePoint {
  Eigen::Vector3d source = Eigen::Vector3d::Zero();
  std::vector<LensPoint> lenses;
};

/// A camera as the stripe is rendered: a pinhole with a margin where `blur` follows, else the camera itself.
struct StripeCamera {
  Camera optics;
  Projector projector;
  Rigid3 camera_from_reference;
  std::vector<HalfSpace> region;  ///< that contains everything visible before and on the laser sheet
  std::optional<LensBlur> blur;
};

struct RenderPlan {
  explicit RenderPlan(const RenderSettings& settings);

  RenderSettings settings;  ///< with camera poses in the reference frame
  LaserEmitter laser;       ///< without power in a background frame
  SamplingPattern pattern;
  /// The reference frame is the frame of the sheet, so that a misaligned sheet costs no more than an aligned
  /// one.
  Rigid3 sensor_from_reference;
  /// Source point of each sample of a pixel: a single one, or padded to full packets.
  std::vector<Eigen::Vector3d> lane_sources;
  /// Per camera: lens point of each sample: a single one, or padded to full packets.
  std::vector<std::vector<Eigen::Vector3d>> lane_viewpoints;
  std::vector<Lanes3> sources;                                    ///< source points per packet
  std::vector<CameraSamples> samples;                             ///< per camera
  std::vector<Projector> projectors;                              ///< per camera
  std::shared_ptr<const SpeckleTile> speckle_tile;                ///< null: no speckle
  std::vector<std::shared_ptr<const SpeckleTile>> pixel_speckle;  ///< per camera: averaged over a pixel
  std::vector<StripeCamera> stripe_cameras;
  /// Points that the stripe averages over: a single one for a point source and lenses that need no sampling.
  std::vector<LatticePoint> stripe_lattice;
  double slope = 0.0;    ///< bound of |x| / distance from the source of all light within the cameras' fields
  double nearest = 0.0;  ///< least distance of the cameras' fields from the source along z, m
  double pixel_size = 0.0;  ///< smallest footprint of a pixel in the measuring field, m
  std::vector<HalfSpace> laser_region;
  std::vector<std::vector<HalfSpace>> camera_fields;  ///< entire fields of view
  /// Per camera: electrons per second and per W/m² of diffusely reflected irradiance, for a pixel on the
  /// optical axis.
  std::vector<double> electrons_per_irradiance;

  /// Returns the source point of lane l of the `packet`-th sixteen samples of a pixel.
  const Eigen::Vector3d& source(std::size_t packet, int l) const { return of_lane(lane_sources, packet, l); }
  /// Returns its lens point at a camera.
  const Eigen::Vector3d& viewpoint(std::size_t camera, std::size_t packet, int l) const {
    return of_lane(lane_viewpoints[camera], packet, l);
  }

 private:
  static const Eigen::Vector3d& of_lane(const std::vector<Eigen::Vector3d>& points, std::size_t packet,
                                        int l) {
    return points.size() == 1 ? points.front() : points[packet * kLanes + static_cast<std::size_t>(l)];
  }
};

}  // namespace sensor_rt
