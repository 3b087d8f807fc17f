// Strict reading of JSON objects: missing and unknown keys are errors.
#pragma once

#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

namespace sensor_rt {

/// Reads the keys of one object. Throws std::invalid_argument that names the path of the key and the error.
class JsonObject {
 public:
  JsonObject(const nlohmann::json& json, std::string path);

  double number(const std::string& key);
  double positive(const std::string& key);
  double non_negative(const std::string& key);
  double fraction(const std::string& key);  ///< 0..1
  long long integer(const std::string& key, long long least, long long most);
  bool boolean(const std::string& key);
  std::string text(const std::string& key);
  /// Returns the index of the text in `choices`.
  std::size_t choice(const std::string& key, const std::vector<std::string>& choices);
  std::vector<double> numbers(const std::string& key, std::size_t count);
  /// Returns a list of any length.
  std::vector<double> numbers(const std::string& key);
  JsonObject object(const std::string& key);
  std::vector<JsonObject> objects(const std::string& key);

  /// Throws when a key was not read.
  void finish() const;

  [[noreturn]] void fail(const std::string& key, const std::string& complaint) const;

 private:
  const nlohmann::json& take(const std::string& key);

  const nlohmann::json* json_;
  std::string path_;
  std::set<std::string> taken_;
};

}  // namespace sensor_rt
