#include "sensor_rt/render/lamps/centre_tracer.h"

#include <cmath>

namespace sensor_rt {

CentreTracer::CentreTracer(const RenderPlan& plan, const ExposureViews& views, RowViews* rows,
                           std::size_t camera)
    : plan_(plan), views_(views), rows_(rows), rays_(plan, camera) {}

CentreTracer::Centre CentreTracer::trace(int column, int row) const {
  Centre centre{rows_ != nullptr ? rows_->of_row(rays_.camera(), row) : views_, {}, {}};
  rays_.through_centre(column, row, centre.direction);
  alignas(64) const int valid[kLanes] = {-1};
  centre.views.middles[rays_.camera()].intersect(0, centre.direction, valid, centre.hits);
  return centre;
}

double CentreTracer::reflectance(int column, int row) const {
  const Centre centre = trace(column, row);
  if (centre.hits.shape[0] < 0) return 0.0;
  const Shape& shape = views_.query.scene().shapes()[static_cast<std::size_t>(centre.hits.shape[0])];
  if (shape.surface->is_lambert()) return shape.reflectance;
  return shape.surface->albedo(
      std::abs(lane(centre.hits.normal, 0).dot(lane(centre.direction, 0).normalized())));
}

LampView CentreTracer::lamp_light(int column, int row) const {
  const Centre centre = trace(column, row);
  const std::int32_t shape = centre.hits.shape[0];
  if (shape < 0) return {};
  Lanes3 origin;
  set_lane(origin, 0, plan_.settings.model.cameras[rays_.camera()].sensor_from_camera.translation);
  const SceneQuery& query = centre.views.query;
  const SurfacePoint at(query, centre.views.middle_instant(), origin, centre.direction, centre.hits, 0);
  const SensorModel& model = plan_.settings.model;
  const Lamps lamps(query, model.band_pass, model.laser.wavelength);
  const double light = lamps.brightness(at, query.brdf(shape), centre.views.middle_instant());
  return {light > 0.0 ? electrons(column, row, light) : 0.0, shape, at.normal};
}

std::int32_t CentreTracer::shape_at(int column, int row) const {
  const Centre centre = trace(column, row);
  return centre.hits.shape[0];
}

}  // namespace sensor_rt
