#include "fmu/fmi/resource_location.h"

#include <stdexcept>

namespace robotcell::fmi {
namespace {

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

std::string percent_decoded(const std::string& uri) {
  std::string path;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      path += uri[i];
      continue;
    }
    const int high = i + 2 < uri.size() ? hex_digit(uri[i + 1]) : -1;
    const int low = i + 2 < uri.size() ? hex_digit(uri[i + 2]) : -1;
    if (high < 0 || low < 0) {
      throw std::invalid_argument("the resource location '" + uri + "' has an invalid percent-encoding");
    }
    path += static_cast<char>(16 * high + low);
    i += 2;
  }
  return path;
}

bool has_file_scheme(const std::string& location) {
  static const std::string scheme = "file:";
  if (location.size() < scheme.size()) return false;
  for (std::size_t i = 0; i < scheme.size(); ++i) {
    const char c = location[i];
    if ((c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c) != scheme[i]) return false;
  }
  return true;
}

/// Path of a file URI without scheme and host, still percent-encoded.
std::string path_of_uri(const std::string& location) {
  std::string rest = location.substr(5);
  if (rest.rfind("//", 0) == 0) {
    const std::size_t slash = rest.find('/', 2);
    const std::string host = rest.substr(2, slash == std::string::npos ? slash : slash - 2);
    if (!host.empty() && host != "localhost") {
      throw std::invalid_argument("the resource location '" + location + "' is on another host");
    }
    rest = slash == std::string::npos ? "/" : rest.substr(slash);
  }
  return rest;
}

#ifdef _WIN32
/// The path of "file:///C:/folder" is "/C:/folder"; Windows opens it without the first slash.
std::string without_slash_before_drive(const std::string& path) {
  return path.size() > 2 && path[0] == '/' && path[2] == ':' ? path.substr(1) : path;
}
#endif

}  // namespace

std::string resource_folder(const std::string& location) {
  if (location.empty()) throw std::invalid_argument("the importer passed no resource location");
  std::string path = location;
  if (has_file_scheme(location)) {
    path = percent_decoded(path_of_uri(location));
#ifdef _WIN32
    path = without_slash_before_drive(path);
#endif
  } else if (location.find("://") != std::string::npos) {
    throw std::invalid_argument("the resource location '" + location + "' is neither a path nor a file URI");
  }
  while (path.size() > 1 && path.back() == '/') path.pop_back();
  return path;
}

}  // namespace robotcell::fmi
