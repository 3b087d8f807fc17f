// Messages to the importer, by category.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace robotcell::fmi {

/// What messages are about; the first three of the names that FMI 2 predefines for all FMUs.
enum class LogCategory : std::size_t { kError, kWarning, kEvent };

struct LogCategoryText {
  const char* name;
  const char* description;
};

/// By category; the last, "logAll", stands for all of them.
constexpr std::array<LogCategoryText, 4> kLogCategories{{
    {"logStatusError", "Errors: what was wrong, and where; logged even with logging off"},
    {"logStatusWarning", "What was odd, though the call did its work"},
    {"logEvents", "What happens: the cell's start, exposures, limits, steps that end early, the end"},
    {"logAll", "Every message"},
}};

/// Decides what reaches the importer.
class Log {
 public:
  using Sink = std::function<void(LogCategory category, const std::string& message)>;

  /// `sink` may be empty. `on` switches all categories.
  Log(Sink sink, bool on) : sink_(std::move(sink)) { switch_all(on); }

  /// Errors always, other categories where they are switched on.
  bool wants(LogCategory category) const { return sink_ && on_[static_cast<std::size_t>(category)]; }
  void write(LogCategory category, const std::string& message) const;

  /// The categories named, or all where none is named, are switched on or off; the others stay (FMI 3).
  /// A name that does not exist is left out, and returned (the last of them; "" for none).
  std::string change(bool on, const std::vector<std::string>& names);

  /// The categories named (all where none is named) are switched on and the others off; all are switched off
  /// with `on` false (FMI 2).
  std::string choose(bool on, const std::vector<std::string>& names);

 private:
  void switch_all(bool on);

  Sink sink_;
  std::array<bool, kLogCategories.size() - 1> on_{};
};

}  // namespace robotcell::fmi
