#include "fmu/model/description/program_file.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "fmu/control/time_units.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/model/description/json_reader.h"

namespace robotcell {
namespace {

using control::Axes;
using control::kFirstFurtherAxis;
using control::kTableAxis;

constexpr int kFormat = 2;
constexpr double kMaxAngle = 1e6;  // rad; a table may turn without end
constexpr double kOnGrid = 1e-6;   // s, largest deviation of a time from its controller cycle

double angle(const JsonReader& json) { return json.number(-kMaxAngle, kMaxAngle); }

void check_times(const JsonReader& json, double cycle) {
  const auto times = json.items(2, std::numeric_limits<std::int32_t>::max());
  for (std::size_t k = 0; k < times.size(); ++k) {
    const double expected = static_cast<double>(k) * cycle;
    if (std::abs(times[k].number() - expected) <= kOnGrid) continue;
    times[k].fail("a set-point in every controller cycle, here at " + std::to_string(expected) + " s");
  }
}

control::ProgramSegment read_segment(const JsonReader& json, std::size_t joints, std::size_t axes,
                                     double cycle) {
  json.require_keys({"id", "time", "q", "table"});
  check_times(json.at("time"), cycle);
  const std::size_t count = json.at("time").items().size();
  const auto rows = json.at("q").items(count);
  const auto table = json.at("table").items(count);
  if (axes > 0) json.require_keys({"further"});
  const auto further = axes > 0 ? json.at("further").items(count) : std::vector<JsonReader>();
  std::vector<Axes> set_points(count, Axes{});
  for (std::size_t k = 0; k < count; ++k) {
    const auto row = rows[k].items(joints);
    for (std::size_t i = 0; i < joints; ++i) set_points[k][i] = angle(row[i]);
    set_points[k][kTableAxis] = angle(table[k]);
    const auto positions = axes > 0 ? further[k].items(axes) : std::vector<JsonReader>();
    for (std::size_t i = 0; i < axes; ++i) set_points[k][kFirstFurtherAxis + i] = angle(positions[i]);
  }
  const auto id = json.at("id").integer(1, std::numeric_limits<std::int32_t>::max());
  return control::interpolated_segment(static_cast<std::int32_t>(id), cycle, set_points);
}

control::Program parse_program(const std::string& text, std::size_t joints, std::size_t axes, double cycle) {
  const nlohmann::json document = parse_json(text);
  const JsonReader json(document, "");
  json.require_keys({"format", "segments"});
  json.at("format").integer(kFormat, kFormat);
  control::Program program;
  for (const JsonReader& item : json.at("segments").items()) {
    control::ProgramSegment segment = read_segment(item, joints, axes, cycle);
    const auto same = [&segment](const control::ProgramSegment& other) { return other.id == segment.id; };
    if (std::any_of(program.segments.begin(), program.segments.end(), same)) {
      item.at("id").fail("an id that no other segment has");
    }
    program.segments.push_back(std::move(segment));
  }
  return program;
}

}  // namespace

std::shared_ptr<const control::Program> read_program(const std::string& path, std::size_t joints,
                                                     std::size_t axes, std::int64_t cycle_us) {
  const std::string text = read_text_file(path);
  try {
    const double cycle = static_cast<double>(cycle_us) * kSecondsPerMicrosecond;
    return std::make_shared<const control::Program>(parse_program(text, joints, axes, cycle));
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
}

}  // namespace robotcell
