// Strict JSON reader: errors name the path of the key, its value and what was expected.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace robotcell {

/// Parses JSON; throws DescriptionError.
nlohmann::json parse_json(const std::string& text);

class JsonReader {
 public:
  JsonReader(const nlohmann::json& node, std::string path) : node_(node), path_(std::move(path)) {}

  /// Requires an object with these keys and, where present, the optional ones, but no others.
  void expect_keys(const std::vector<const char*>& keys, const std::vector<const char*>& optional = {}) const;

  /// Requires an object with these keys, and ignores all others.
  void require_keys(const std::vector<const char*>& keys) const;

  bool is_null() const { return node_.is_null(); }
  bool has(const char* key) const { return node_.contains(key); }
  JsonReader at(const char* key) const;
  /// Elements of the array with this key; none where the key is absent.
  std::vector<JsonReader> items_at(const char* key) const;
  std::vector<JsonReader> items() const;
  std::vector<JsonReader> items(std::size_t count) const;
  std::vector<JsonReader> items(std::size_t min, std::size_t max) const;

  double number() const;
  double number(double min, double max) const;
  double positive() const;
  /// A number above 0 and at most kMaxCoordinate.
  double length() const;
  double mass() const;
  std::int64_t integer(std::int64_t min, std::int64_t max) const;
  bool boolean() const;
  std::string text() const;
  Eigen::Vector3d vector3() const;
  /// A vector within +-kMaxCoordinate, for positions and gravity.
  Eigen::Vector3d coordinates() const;
  /// Vertices of a mesh from base64 text of little-endian 64-bit floats, x, y, z each.
  std::vector<Eigen::Vector3d> vertices() const;
  /// Faces of a mesh from base64 text of little-endian 32-bit integers, three zero-based vertex indices each.
  std::vector<std::array<int, 3>> faces(std::size_t vertices) const;
  Eigen::Isometry3d pose() const;

  [[noreturn]] void fail(const std::string& expected) const;

 private:
  JsonReader item(std::size_t index) const;
  /// What precedes a key of this object in messages.
  std::string prefix() const { return path_.empty() ? "" : path_ + "."; }
  /// Rows of three numbers of type T from base64 text.
  template <class T>
  std::vector<std::array<T, 3>> rows(const char* expected) const;

  const nlohmann::json& node_;
  std::string path_;
};

}  // namespace robotcell
