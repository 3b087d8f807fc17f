#include "fmu/fmi/log.h"

namespace robotcell::fmi {

void Log::write(LogCategory category, const std::string& message) const {
  if (writing_ || !wants(category)) return;
  writing_ = true;
  sink_(category, message);
  writing_ = false;
}

void Log::switch_all(bool on) {
  on_.fill(on);
  on_[static_cast<std::size_t>(LogCategory::kError)] = true;
}

std::string Log::switch_categories(bool on, const std::vector<std::string>& names) {
  if (names.empty()) switch_all(on);
  std::string unknown;
  for (const std::string& name : names) {
    std::size_t i = 0;
    while (i < kLogCategories.size() && name != kLogCategories[i].name) ++i;
    if (i == kLogCategories.size()) {
      unknown = name;
    } else if (i == on_.size()) {
      switch_all(on);
    } else {
      on_[i] = on || i == static_cast<std::size_t>(LogCategory::kError);
    }
  }
  return unknown;
}

std::string Log::select_only(bool on, const std::vector<std::string>& names) {
  switch_all(false);
  return on ? switch_categories(true, names) : "";
}

}  // namespace robotcell::fmi
