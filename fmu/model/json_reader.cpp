#include "fmu/model/json_reader.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "fmu/model/cell_description.h"

namespace robotcell {
namespace {

/// m, and m/s^2 of gravity: far beyond it the collision engine ends the process.
constexpr double kGreatestCoordinate = 1000;
/// The engine needs masses (kg) whose reciprocals and products are numbers.
constexpr double kLightest = 1e-9;
constexpr double kHeaviest = 1e9;

std::string shown(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

}  // namespace

void JsonReader::fail(const std::string& expected) const {
  std::string shown = node_.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
  if (shown.size() > 80) shown = shown.substr(0, 77) + "...";
  throw DescriptionError((path_.empty() ? "the cell description" : path_) + ": expected " + expected +
                         ", got " + shown);
}

void JsonReader::expect_keys(std::initializer_list<const char*> keys) const {
  if (!node_.is_object()) fail("an object");
  const std::string prefix = path_.empty() ? "" : path_ + ".";
  for (const char* key : keys) {
    if (!node_.contains(key)) throw DescriptionError(prefix + key + ": this key is missing");
  }
  for (const auto& item : node_.items()) {
    const bool known =
        std::any_of(keys.begin(), keys.end(), [&item](const char* key) { return item.key() == key; });
    if (!known) throw DescriptionError(prefix + item.key() + ": unknown key");
  }
}

JsonReader JsonReader::at(const char* key) const {
  return {node_.at(key), path_.empty() ? key : path_ + "." + key};
}

JsonReader JsonReader::item(std::size_t index) const {
  return {node_[index], path_ + "[" + std::to_string(index) + "]"};
}

std::vector<JsonReader> JsonReader::items() const {
  if (!node_.is_array()) fail("an array");
  std::vector<JsonReader> readers;
  for (std::size_t i = 0; i < node_.size(); ++i) readers.push_back(item(i));
  return readers;
}

std::vector<JsonReader> JsonReader::items(std::size_t count) const {
  if (!node_.is_array() || node_.size() != count) fail("an array of " + std::to_string(count));
  return items();
}

double JsonReader::number() const {
  if (!node_.is_number() || !std::isfinite(node_.get<double>())) fail("a finite number");
  return node_.get<double>();
}

double JsonReader::number(double lowest, double highest) const {
  const double value = number();
  if (value < lowest || value > highest) {
    fail("a number from " + shown(lowest) + " to " + shown(highest));
  }
  return value;
}

double JsonReader::mass() const { return number(kLightest, kHeaviest); }

double JsonReader::positive() const {
  const double value = number();
  if (value <= 0) fail("a number above 0");
  return value;
}

std::int64_t JsonReader::integer(std::int64_t lowest, std::int64_t highest) const {
  if (!node_.is_number_integer()) fail("a whole number");
  const auto value = node_.get<std::int64_t>();
  if (value < lowest || value > highest) {
    fail("a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest));
  }
  return value;
}

bool JsonReader::boolean() const {
  if (!node_.is_boolean()) fail("true or false");
  return node_.get<bool>();
}

std::string JsonReader::text() const {
  if (!node_.is_string()) fail("a string");
  return node_.get<std::string>();
}

Eigen::Vector3d JsonReader::vector3() const {
  const auto values = items(3);
  return {values[0].number(), values[1].number(), values[2].number()};
}

Eigen::Vector3d JsonReader::coordinates() const {
  const auto values = items(3);
  const auto coordinate = [&values](std::size_t i) {
    return values[i].number(-kGreatestCoordinate, kGreatestCoordinate);
  };
  return {coordinate(0), coordinate(1), coordinate(2)};
}

std::vector<Eigen::Vector3d> JsonReader::vectors3() const {
  if (!node_.is_array()) fail("an array");
  const auto is_coordinate = [](const nlohmann::json& node) {
    return node.is_number() && std::abs(node.get<double>()) <= kGreatestCoordinate;
  };
  std::vector<Eigen::Vector3d> vectors;
  vectors.reserve(node_.size());
  for (std::size_t i = 0; i < node_.size(); ++i) {
    const nlohmann::json& node = node_[i];
    const bool is_plain =
        node.is_array() && node.size() == 3 && std::all_of(node.begin(), node.end(), is_coordinate);
    vectors.push_back(is_plain ? Eigen::Vector3d(node[0], node[1], node[2]) : item(i).coordinates());
  }
  return vectors;
}

std::vector<std::array<int, 3>> JsonReader::triangles(std::size_t vertices) const {
  if (!node_.is_array()) fail("an array");
  const auto last = static_cast<std::int64_t>(vertices) - 1;
  const auto is_corner = [last](const nlohmann::json& node) {
    return node.is_number_integer() && node.get<std::int64_t>() >= 0 && node.get<std::int64_t>() <= last;
  };
  std::vector<std::array<int, 3>> triangles;
  triangles.reserve(node_.size());
  for (std::size_t i = 0; i < node_.size(); ++i) {
    const nlohmann::json& node = node_[i];
    if (node.is_array() && node.size() == 3 && std::all_of(node.begin(), node.end(), is_corner)) {
      triangles.push_back({node[0].get<int>(), node[1].get<int>(), node[2].get<int>()});
      continue;
    }
    for (const JsonReader& corner : item(i).items(3)) corner.integer(0, last);
  }
  return triangles;
}

Eigen::Isometry3d JsonReader::pose() const {
  expect_keys({"position", "quaternion"});
  const auto q = at("quaternion").items(4);
  const Eigen::Quaterniond rotation(q[0].number(), q[1].number(), q[2].number(), q[3].number());
  if (std::abs(rotation.norm() - 1) > 1e-6) at("quaternion").fail("a quaternion w, x, y, z of length 1");
  return Eigen::Translation3d(at("position").coordinates()) * rotation.normalized();
}

}  // namespace robotcell
