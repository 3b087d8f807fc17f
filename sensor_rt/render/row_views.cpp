#include "sensor_rt/render/row_views.h"

#include <algorithm>

namespace sensor_rt {
namespace {

constexpr std::size_t kSamplesKept = 65'536;

}  // namespace

RowViews::RowViews(const RenderPlan& plan, const Scene& scene, const Exposures& exposures,
                   std::size_t exposure, Rows& rows)
    : plan_(plan),
      scene_(scene),
      exposures_(exposures),
      exposure_(exposure),
      timing_(plan.settings.model, plan.settings.row_readout, exposures.duration[exposure]),
      rows_(rows) {
  const auto distinct = 2 * static_cast<std::size_t>(timing_.tallest);
  rows_.resize(std::min(distinct, kSamplesKept / plan.pattern.padded_size()));
  for (const std::unique_ptr<Row>& row : rows_) {
    if (row) row->half_rows = kNone;
  }
}

const ExposureViews& RowViews::of_row(std::size_t camera, int row) {
  const int half_rows = timing_.half_rows(plan_.settings.model.cameras[camera], row);
  std::unique_ptr<Row>& kept = rows_[static_cast<std::size_t>(half_rows) % rows_.size()];
  if (!kept) kept = std::make_unique<Row>();
  if (kept->half_rows == half_rows) return kept->views;
  const double span = timing_.span();
  const double start = (plan_.settings.laser_on ? 0.0 : span) + timing_.start(half_rows);
  std::vector<double> fractions(plan_.pattern.size());
  const auto samples = static_cast<double>(fractions.size());
  for (std::size_t i = 0; i < fractions.size(); ++i) {
    fractions[i] = (start + timing_.open * (static_cast<double>(i) + 0.5) / samples) / span;
  }
  kept->track.set(scene_, exposures_, exposure_, fractions, plan_.sensor_from_reference);
  kept->views.set(plan_, SceneQuery(scene_, kept->track));
  kept->half_rows = half_rows;
  return kept->views;
}

}  // namespace sensor_rt
