#include "sensor_rt/render/row_views.h"

#include <algorithm>

namespace sensor_rt {

RowViews::RowViews(const RenderPlan& plan) : plan_(plan), fractions_(plan.pattern.size()) {
  for (const Camera& camera : plan.settings.model.cameras) tallest_ = std::max(tallest_, camera.height_px);
  rows_.resize(2 * static_cast<std::size_t>(tallest_));
}

void RowViews::set(const Scene& scene, const Exposures& exposures, std::size_t exposure) {
  scene_ = &scene;
  exposures_ = &exposures;
  exposure_ = exposure;
  ++count_;
}

const ExposureViews& RowViews::of_row(std::size_t camera, int row) {
  const int half_rows = 2 * row + tallest_ - plan_.settings.model.cameras[camera].height_px;
  std::unique_ptr<Row>& kept = rows_[static_cast<std::size_t>(half_rows)];
  if (!kept) kept = std::make_unique<Row>();
  if (kept->made_for == count_) return kept->views;
  const double open = exposures_->duration[exposure_];
  const double span = open + plan_.settings.row_readout * (tallest_ - 1);
  const double first = plan_.settings.laser_on ? 0.0 : span;
  const double start = first + 0.5 * half_rows * plan_.settings.row_readout;
  const auto samples = static_cast<double>(fractions_.size());
  for (std::size_t i = 0; i < fractions_.size(); ++i) {
    fractions_[i] = (start + open * (static_cast<double>(i) + 0.5) / samples) / span;
  }
  kept->track.set(*scene_, *exposures_, exposure_, fractions_, plan_.sensor_from_reference);
  kept->views.set(plan_, *scene_, kept->track);
  kept->made_for = count_;
  return kept->views;
}

}  // namespace sensor_rt
