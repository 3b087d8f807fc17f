#include "fmu/model/description/json_reader.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <sstream>

#include "fmu/model/description/cell_description.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {
namespace {

/// kg. The engine needs masses whose reciprocals and products are finite; with parts of 1e-8 kg and forces of
/// 60 N an assertion of its contact solver ends the process.
constexpr double kMinMass = 1e-6;
constexpr double kMaxMass = 1e9;

static_assert(sizeof(std::array<double, 3>) == 24 && sizeof(std::array<std::int32_t, 3>) == 12);

/// Decodes base64 (RFC 4648, with padding); empty where the text is invalid.
std::optional<std::vector<std::uint8_t>> base64_bytes(const std::string& text) {
  static const std::array<std::int8_t, 256> values = [] {
    std::array<std::int8_t, 256> table;
    table.fill(-1);
    std::int8_t value = 0;
    for (const char c : "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/") {
      if (c != '\0') table[static_cast<std::uint8_t>(c)] = value++;
    }
    return table;
  }();
  if (text.size() % 4 != 0) return std::nullopt;
  const std::size_t end = text.find_last_not_of('=') + 1;  // 0 where the text is padding only
  if (text.size() - end > 2) return std::nullopt;
  std::vector<std::uint8_t> bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < end; ++i) {
    const std::int8_t value = values[static_cast<std::uint8_t>(text[i])];
    if (value < 0) return std::nullopt;
    bits = bits << 6 | static_cast<std::uint32_t>(value);
    // A character has 6 bits: from the second of each group of four on, one more byte is complete.
    const std::size_t left_over = (i + 1) * 6 % 8;
    if (i % 4 != 0) bytes.push_back(static_cast<std::uint8_t>(bits >> left_over));
  }
  return bytes;
}

std::string formatted(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

}  // namespace

nlohmann::json parse_json(const std::string& text) {
  try {
    return nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception& error) {  // a number beyond the range of double is no parse_error
    throw DescriptionError(std::string("not valid JSON: ") + error.what());
  }
}

void JsonReader::fail(const std::string& expected) const {
  std::string formatted = node_.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
  if (formatted.size() > 80) formatted = formatted.substr(0, 77) + "...";
  throw DescriptionError((path_.empty() ? "the description" : path_) + ": expected " + expected + ", got " +
                         formatted);
}

void JsonReader::require_keys(const std::vector<const char*>& keys) const {
  if (!node_.is_object()) fail("an object");
  for (const char* key : keys) {
    if (!node_.contains(key)) throw DescriptionError(prefix() + key + ": missing key");
  }
}

void JsonReader::expect_keys(const std::vector<const char*>& keys,
                             const std::vector<const char*>& optional) const {
  require_keys(keys);
  for (const auto& item : node_.items()) {
    const auto is_this = [&item](const char* key) { return item.key() == key; };
    const bool known = std::any_of(keys.begin(), keys.end(), is_this) ||
                       std::any_of(optional.begin(), optional.end(), is_this);
    if (!known) throw DescriptionError(prefix() + item.key() + ": unknown key");
  }
}

std::vector<JsonReader> JsonReader::items_at(const char* key) const {
  return has(key) ? at(key).items() : std::vector<JsonReader>();
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
  if (!node_.is_array() || node_.size() != count) fail("an array of length " + std::to_string(count));
  return items();
}

std::vector<JsonReader> JsonReader::items(std::size_t min, std::size_t max) const {
  if (!node_.is_array() || node_.size() < min || node_.size() > max) {
    fail("an array of length " + std::to_string(min) + " to " + std::to_string(max));
  }
  return items();
}

double JsonReader::number() const {
  if (!node_.is_number() || !std::isfinite(node_.get<double>())) fail("a finite number");
  return node_.get<double>();
}

double JsonReader::number(double min, double max) const {
  const double value = number();
  if (value < min || value > max) {
    fail("a number from " + formatted(min) + " to " + formatted(max));
  }
  return value;
}

double JsonReader::mass() const { return number(kMinMass, kMaxMass); }

double JsonReader::length() const {
  const double value = positive();
  if (value > kMaxCoordinate) fail("a number above 0 and at most 1000");
  return value;
}

double JsonReader::positive() const {
  const double value = number();
  if (value <= 0) fail("a number above 0");
  return value;
}

std::int64_t JsonReader::integer(std::int64_t min, std::int64_t max) const {
  if (!node_.is_number_integer()) fail("an integer");
  const auto value = node_.get<std::int64_t>();
  if (value < min || value > max) {
    fail("an integer from " + std::to_string(min) + " to " + std::to_string(max));
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
    return values[i].number(-kMaxCoordinate, kMaxCoordinate);
  };
  return {coordinate(0), coordinate(1), coordinate(2)};
}

template <class T>
std::vector<std::array<T, 3>> JsonReader::rows(const char* expected) const {
  const auto bytes = node_.is_string() ? base64_bytes(node_.get_ref<const std::string&>()) : std::nullopt;
  if (!bytes || bytes->size() % sizeof(std::array<T, 3>) != 0) fail(expected);
  std::vector<std::array<T, 3>> rows(bytes->size() / sizeof(std::array<T, 3>));
  if (!rows.empty()) std::memcpy(rows.data(), bytes->data(), bytes->size());
  return rows;
}

std::vector<Eigen::Vector3d> JsonReader::vertices() const {
  const auto rows = this->rows<double>("base64 text of three little-endian 64-bit floats for each vertex");
  std::vector<Eigen::Vector3d> vertices;
  vertices.reserve(rows.size());
  for (const auto& [x, y, z] : rows) {
    const Eigen::Vector3d vertex(x, y, z);
    if (!(vertex.cwiseAbs().maxCoeff() <= kMaxCoordinate) || vertex.hasNaN()) {
      throw DescriptionError(path_ + ": vertex " + std::to_string(vertices.size()) +
                             ": expected coordinates from " + formatted(-kMaxCoordinate) + " to " +
                             formatted(kMaxCoordinate) + ", got " + formatted(x) + ", " + formatted(y) +
                             ", " + formatted(z));
    }
    vertices.push_back(vertex);
  }
  return vertices;
}

std::vector<std::array<int, 3>> JsonReader::faces(std::size_t vertices) const {
  auto faces = rows<std::int32_t>("base64 text of three little-endian 32-bit integers for each face");
  for (std::size_t i = 0; i < faces.size(); ++i) {
    for (const std::int32_t corner : faces[i]) {
      if (corner >= 0 && static_cast<std::size_t>(corner) < vertices) continue;
      throw DescriptionError(path_ + ": face " + std::to_string(i) + ": expected vertex indices below " +
                             std::to_string(vertices) + ", got " + std::to_string(corner));
    }
  }
  return faces;
}

Eigen::Isometry3d JsonReader::pose() const {
  expect_keys({"position", "quaternion"});
  const auto q = at("quaternion").items(4);
  const Eigen::Quaterniond rotation(q[0].number(), q[1].number(), q[2].number(), q[3].number());
  if (std::abs(rotation.norm() - 1) > 1e-6) at("quaternion").fail("a unit quaternion [w, x, y, z]");
  return Eigen::Translation3d(at("position").coordinates()) * rotation.normalized();
}

}  // namespace robotcell
