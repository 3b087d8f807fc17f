#include "sensor_rt/pipeline/json_object.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace sensor_rt {

JsonObject::JsonObject(const nlohmann::json& json, std::string path) : json_(&json), path_(std::move(path)) {
  if (!json.is_object()) throw std::invalid_argument(path_ + ": expected an object, got " + json.type_name());
}

void JsonObject::fail(const std::string& key, const std::string& complaint) const {
  throw std::invalid_argument(path_ + "." + key + ": " + complaint);
}

const nlohmann::json& JsonObject::take(const std::string& key) {
  const auto found = json_->find(key);
  if (found == json_->end()) fail(key, "missing");
  taken_.insert(key);
  return *found;
}

double JsonObject::number(const std::string& key) {
  const nlohmann::json& value = take(key);
  if (!value.is_number()) fail(key, std::string("expected a number, got ") + value.type_name());
  const double number = value.get<double>();
  if (!std::isfinite(number)) fail(key, "must be finite");
  return number;
}

double JsonObject::positive(const std::string& key) {
  const double value = number(key);
  if (!(value > 0.0)) fail(key, "must be positive, got " + std::to_string(value));
  return value;
}

double JsonObject::non_negative(const std::string& key) {
  const double value = number(key);
  if (value < 0.0) fail(key, "must not be negative, got " + std::to_string(value));
  return value;
}

double JsonObject::fraction(const std::string& key) {
  const double value = number(key);
  if (value < 0.0 || value > 1.0) fail(key, "must lie in 0..1, got " + std::to_string(value));
  return value;
}

long long JsonObject::integer(const std::string& key, long long least, long long most) {
  const nlohmann::json& value = take(key);
  if (!value.is_number_integer()) fail(key, std::string("expected an integer, got ") + value.dump());
  const bool too_large =
      value.is_number_unsigned() && value.get<unsigned long long>() > 0x7FFFFFFFFFFFFFFFull;
  const long long number = too_large ? 0 : value.get<long long>();
  if (too_large || number < least || number > most) {
    fail(key, "must lie in " + std::to_string(least) + ".." + std::to_string(most) + ", got " + value.dump());
  }
  return number;
}

bool JsonObject::boolean(const std::string& key) {
  const nlohmann::json& value = take(key);
  if (!value.is_boolean()) fail(key, std::string("expected true or false, got ") + value.dump());
  return value.get<bool>();
}

std::string JsonObject::text(const std::string& key) {
  const nlohmann::json& value = take(key);
  if (!value.is_string()) fail(key, std::string("expected a string, got ") + value.type_name());
  return value.get<std::string>();
}

std::size_t JsonObject::choice(const std::string& key, const std::vector<std::string>& choices) {
  const std::string value = text(key);
  const auto found = std::find(choices.begin(), choices.end(), value);
  if (found == choices.end()) {
    std::string expected;
    for (const std::string& name : choices) expected += (expected.empty() ? "" : ", ") + name;
    fail(key, "expected one of " + expected + ", got " + value);
  }
  return static_cast<std::size_t>(found - choices.begin());
}

std::vector<double> JsonObject::numbers(const std::string& key, std::size_t count) {
  const nlohmann::json& value = take(key);
  if (!value.is_array() || value.size() != count) fail(key, "expected " + std::to_string(count) + " numbers");
  return numbers(key);
}

std::vector<double> JsonObject::numbers(const std::string& key) {
  const nlohmann::json& value = take(key);
  if (!value.is_array()) fail(key, "expected a list of numbers");
  std::vector<double> result;
  for (const nlohmann::json& item : value) {
    if (!item.is_number() || !std::isfinite(item.get<double>())) fail(key, "expected finite numbers");
    result.push_back(item.get<double>());
  }
  return result;
}

JsonObject JsonObject::object(const std::string& key) { return {take(key), path_ + "." + key}; }

std::vector<JsonObject> JsonObject::objects(const std::string& key) {
  const nlohmann::json& value = take(key);
  if (!value.is_array() || value.empty()) fail(key, "expected a list with at least one entry");
  std::vector<JsonObject> result;
  for (std::size_t i = 0; i < value.size(); ++i) {
    result.emplace_back(value[i], path_ + "." + key + "[" + std::to_string(i) + "]");
  }
  return result;
}

void JsonObject::finish() const {
  for (const auto& item : json_->items()) {
    if (taken_.count(item.key()) == 0) fail(item.key(), "unknown key");
  }
}

}  // namespace sensor_rt
