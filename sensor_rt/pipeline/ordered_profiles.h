// Collection of profiles from several threads in the order of the exposures.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

#include "sensor_rt/imaging/triangulate.h"

namespace sensor_rt {

/// Threads acquire buffers, fill them and submit them with the index of their exposure. Profiles in sequence
/// are appended immediately; only those that arrive early wait. Buffers are reused.
class OrderedProfiles {
 public:
  /// `points`: estimated total number of points, for the allocation.
  explicit OrderedProfiles(std::size_t points);

  /// Returns an empty buffer.
  Profiles acquire();

  /// Submits the filled buffer of exposure `number`; each index from 0 must be submitted once.
  void submit(std::size_t number, Profiles&& profiles);

  /// Returns all profiles; call after all exposures have been submitted.
  Profiles take() { return std::move(all_); }

 private:
  std::mutex guard_;
  std::size_t next_ = 0;
  std::map<std::size_t, Profiles> waiting_;
  std::vector<Profiles> free_;
  Profiles all_;
};

}  // namespace sensor_rt
