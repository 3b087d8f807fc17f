#include "sensor_rt/imaging/choose.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

constexpr double kColumnsPerJump = 64.0;
constexpr double kJumpsPerAgreement = 4.0;

/// Returns the first candidate of the column after that of candidate `begin`.
std::size_t end_of_column(const std::vector<Candidate>& candidates, std::size_t begin) {
  std::size_t end = begin + 1;
  while (end < candidates.size() && candidates[end].column == candidates[begin].column) ++end;
  return end;
}

/// A range of candidates in one column.
struct Column {
  std::size_t begin = 0;
  std::size_t end = 0;
};

/// Computes the scores of the best paths that end in each candidate, column by column.
class PathSearch {
 public:
  PathSearch(const CameraPeaks& peaks, double jump_px)
      : peaks_(peaks),
        jump_px_(jump_px),
        score_(peaks.candidates.size(), 0.0),
        before_(peaks.candidates.size(), 0) {}

  void advance(const Column& last, const Column& next) {
    float brightest = 1e-6f;
    for (std::size_t i = next.begin; i < next.end; ++i) brightest = std::max(brightest, strength(i));
    for (std::size_t i = next.begin; i < next.end; ++i) {
      double best = 0.0;
      for (std::size_t j = last.begin; j < last.end; ++j) {
        const double score = score_[j] - jump(j, i);
        if (j > last.begin && score <= best) continue;
        best = score;
        before_[i] = j;
      }
      score_[i] = best + static_cast<double>(strength(i) / brightest) / kColumnsPerJump + agreement(i);
    }
  }

  /// Returns the candidates of the best path that ends in the column `last`, ascending, over `columns`
  /// columns.
  std::vector<std::size_t> trace(const Column& last, std::size_t columns) const {
    std::vector<std::size_t> path(columns);
    const auto first = score_.begin() + static_cast<std::ptrdiff_t>(last.begin);
    const auto end = score_.begin() + static_cast<std::ptrdiff_t>(last.end);
    auto at = static_cast<std::size_t>(std::max_element(first, end) - score_.begin());
    for (std::size_t k = columns; k-- > 0; at = before_[at]) path[k] = at;
    return path;
  }

 private:
  float strength(std::size_t i) const { return peaks_.candidates[i].amplitude; }

  double agreement(std::size_t i) const {
    return peaks_.agreement.empty() ? 0.0 : -kJumpsPerAgreement * static_cast<double>(peaks_.agreement[i]);
  }

  /// Jumps up to half of jump_px are free, as sloped stripes need them. The limit grows over columns without
  /// peaks.
  double jump(std::size_t from, std::size_t to) const {
    const int gap = peaks_.candidates[to].column - peaks_.candidates[from].column;
    const double rows = std::fabs(peaks_.fits[to].row - peaks_.fits[from].row);
    return std::clamp(2.0 * rows / (jump_px_ * std::sqrt(gap)) - 1.0, 0.0, 1.0);
  }

  const CameraPeaks& peaks_;
  double jump_px_;
  std::vector<double> score_;
  std::vector<std::size_t> before_;
};

}  // namespace

std::vector<std::size_t> choose_by_rank(PeakChoice choice, const std::vector<Candidate>& candidates) {
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (chosen.empty() || candidates[chosen.back()].column != candidates[i].column) {
      chosen.push_back(i);
    } else if (choice == PeakChoice::kLast || (choice == PeakChoice::kBrightest &&
                                               candidates[i].strength > candidates[chosen.back()].strength)) {
      chosen.back() = i;
    }
  }
  return chosen;
}

void keep_by_rank(PeakChoice choice, std::vector<Candidate>& candidates) {
  std::size_t kept = 0;
  for (const std::size_t i : choose_by_rank(choice, candidates)) candidates[kept++] = candidates[i];
  candidates.resize(kept);
}

std::vector<std::size_t> choose_continuous(const CameraPeaks& peaks, double jump_px) {
  PathSearch search(peaks, jump_px);
  Column last;
  std::size_t columns = 0;
  while (last.end < peaks.candidates.size()) {
    const Column next{last.end, end_of_column(peaks.candidates, last.end)};
    search.advance(last, next);
    last = next;
    ++columns;
  }
  return columns > 0 ? search.trace(last, columns) : std::vector<std::size_t>{};
}

}  // namespace sensor_rt
