// Log messages to the importer, by category.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace robotcell::fmi {

/// Categories of messages: the first three are predefined by FMI 2.
enum class LogCategory : std::size_t { kError, kWarning, kEvent };

struct LogCategoryText {
  const char* name;
  const char* description;
};

/// By category; the last entry, "logAll", selects all categories.
constexpr std::array<LogCategoryText, 4> kLogCategories{{
    {"logStatusError", "Errors, with the variable or function concerned; always logged"},
    {"logStatusWarning", "Warnings: the call succeeded with limitations"},
    {"logEvents",
     "Events: cell loaded, trigger records, axis limits, collisions, early returns, termination"},
    {"logAll", "All messages"},
}};

/// Filters messages by category. One message is written at a time: what the importer calls from its callback
/// is refused (`guarded`) and writes nothing.
class Log {
 public:
  using Sink = std::function<void(LogCategory category, const std::string& message)>;

  /// `sink` may be empty. `on` switches all categories.
  Log(Sink sink, bool on) : sink_(std::move(sink)) { switch_all(on); }

  /// True for errors, and for other categories that are switched on.
  bool wants(LogCategory category) const { return sink_ && on_[static_cast<std::size_t>(category)]; }
  void write(LogCategory category, const std::string& message) const;

  /// Whether the importer's callback runs.
  bool is_writing() const { return writing_; }

  /// Switches the named categories, or all where none is named, on or off and leaves the others (FMI 3).
  /// Returns an unknown name (the last one), or "".
  std::string switch_categories(bool on, const std::vector<std::string>& names);

  /// Switches the named categories (all where none is named) on and all others off; all off where `on` is
  /// false (FMI 2). Returns an unknown name (the last one), or "".
  std::string select_only(bool on, const std::vector<std::string>& names);

 private:
  void switch_all(bool on);

  Sink sink_;
  std::array<bool, kLogCategories.size() - 1> on_{};
  mutable bool writing_ = false;
};

}  // namespace robotcell::fmi
