// Profiles from many threads, put together in the order of their exposures.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

#include "sensor_rt/imaging/triangulate.h"

namespace sensor_rt {

/// Threads borrow buffers, fill them and hand them back with the number of their exposure. What is in order
/// is appended at once, so that only the few profiles that overtook others wait, and memory is used again.
class OrderedProfiles {
 public:
  /// Expects about `points` in all.
  explicit OrderedProfiles(std::size_t points);

  /// An empty buffer.
  Profiles borrow();

  /// Takes the filled buffer of exposure `number`; each number from 0 up comes once.
  void hand_in(std::size_t number, Profiles&& profiles);

  /// All profiles; to be called when every exposure has come.
  Profiles take() { return std::move(all_); }

 private:
  std::mutex guard_;
  std::size_t next_ = 0;
  std::map<std::size_t, Profiles> waiting_;
  std::vector<Profiles> free_;
  Profiles all_;
};

}  // namespace sensor_rt
