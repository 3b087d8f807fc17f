// Strict reading of JSON: every key must be there, no other may be, and an error says which one is wrong.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace robotcell {

class JsonReader {
 public:
  JsonReader(const nlohmann::json& node, std::string path) : node_(node), path_(std::move(path)) {}

  /// Refuses anything but an object with exactly these keys.
  void expect_keys(std::initializer_list<const char*> keys) const;

  bool is_null() const { return node_.is_null(); }
  JsonReader at(const char* key) const;
  std::vector<JsonReader> items() const;
  std::vector<JsonReader> items(std::size_t count) const;

  double number() const;
  double number(double lowest, double highest) const;
  double positive() const;
  double mass() const;
  std::int64_t integer(std::int64_t lowest, std::int64_t highest) const;
  bool boolean() const;
  std::string text() const;
  Eigen::Vector3d vector3() const;
  /// Of a place, or of gravity: within what the engine can work with.
  Eigen::Vector3d coordinates() const;
  /// Meshes have so many of these that only what is wrong is given a path.
  std::vector<Eigen::Vector3d> vectors3() const;
  std::vector<std::array<int, 3>> triangles(std::size_t vertices) const;
  Eigen::Isometry3d pose() const;

  [[noreturn]] void fail(const std::string& expected) const;

 private:
  JsonReader item(std::size_t index) const;

  const nlohmann::json& node_;
  std::string path_;
};

}  // namespace robotcell
