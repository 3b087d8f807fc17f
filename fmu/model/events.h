// Events that are reported to importers in event mode: one bit for each source.
#pragma once

#include <cstdint>

namespace robotcell {

using Events = std::uint32_t;
constexpr Events kRecordPublished = 1u << 0;
constexpr Events kCollisionChanged = 1u << 1;  // the first collision began, or the last one ended
constexpr Events kAllEvents = ~Events{0};

}  // namespace robotcell
