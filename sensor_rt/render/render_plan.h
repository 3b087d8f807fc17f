// What rendering needs to know of a sensor, prepared once and shared by all threads.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/optics/sensor_model.h"
#include "sensor_rt/render/sampling_pattern.h"

namespace sensor_rt {

struct RenderSettings {
  SensorModel model;
  double quantum_efficiency = 0.0;
  int samples_per_pixel = 0;
  int rays_across_fan = 0;        ///< laser rays that find the pixels to trace
  bool whole_image = false;       ///< trace every pixel instead
  bool ground_truth = false;      ///< path tracing of every pixel
  int bounces = 0;                ///< reflections between surfaces that light may take on its way
  int photons = 0;                ///< that follow such light from the laser
  std::uint64_t seed = 0;         ///< keys the random numbers of all paths, and speckle
  double speckle_contrast = 0.0;  ///< of fully resolved grains; 0: none
  bool laser_on = true;  ///< false: an image of all other light, taken when the one with the laser has ended
  double row_readout = 0.0;  ///< s from one row's exposure to the next; 0: global shutter
};

/// The light counts out to this many standard deviations from the middle of the sheet; it has fallen to 4e-5
/// there.
constexpr double kSheetReach = 4.5;

/// Light or view is free when nothing stands before this share of the way to the surface; the rest is the
/// surface.
constexpr double kBeforeSurface = 1.0 - 1e-4;

struct RenderPlan {
  explicit RenderPlan(const RenderSettings& settings);

  RenderSettings settings;  ///< with the cameras placed in the reference frame
  SamplingPattern pattern;
  /// Light is followed in the frame of the sheet, so that a sheet out of place is as easy as one in place.
  Rigid3 sensor_from_reference;
  /// Where the light of each sample of a pixel starts: one for all, or padded to whole packets.
  std::vector<Eigen::Vector3d> lane_sources;
  /// Per camera, where the rays of each sample end: one for all, or padded to whole packets.
  std::vector<std::vector<Eigen::Vector3d>> lane_eyes;
  /// Per camera: how far outside a pixel its samples look for light, px.
  std::vector<double> pixel_reach;
  double slope = 0.0;       ///< |x| / distance from the source that holds all light where any camera sees it
  double pixel_size = 0.0;  ///< smallest distance between neighbouring pixels on surfaces in the field, m
  std::vector<HalfSpace> laser_region;
  std::vector<std::vector<HalfSpace>> camera_regions;  ///< of what light of the sensor makes visible
  std::vector<std::vector<HalfSpace>> camera_fields;   ///< of everything in view
  std::vector<double>
      electrons_per_irradiance;  ///< per camera: electrons per second and per W/m² of diffusely
                                 ///< reflected irradiance, for a pixel on the optical axis

  /// Where the light of lane l of the `packet`-th sixteen samples of a pixel starts.
  const Eigen::Vector3d& source(std::size_t packet, int l) const { return of_lane(lane_sources, packet, l); }
  /// Where its ray ends at a camera.
  const Eigen::Vector3d& eye(std::size_t camera, std::size_t packet, int l) const {
    return of_lane(lane_eyes[camera], packet, l);
  }

 private:
  static const Eigen::Vector3d& of_lane(const std::vector<Eigen::Vector3d>& points, std::size_t packet,
                                        int l) {
    return points.size() == 1 ? points.front() : points[packet * kLanes + static_cast<std::size_t>(l)];
  }
};

}  // namespace sensor_rt
