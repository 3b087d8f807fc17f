// Frames of the cell that bodies and sensors are attached to.
#pragma once

#include <cstddef>

namespace robotcell {

class JsonReader;

struct FrameRef {
  enum class Kind { kWorld, kLink, kSensor, kTable, kPart, kFinger };
  Kind kind = Kind::kWorld;
  std::size_t index = 0;  // of the link, part or finger, zero-based

  bool operator==(const FrameRef& other) const { return kind == other.kind && index == other.index; }
};

/// Number of frames of each kind.
struct FrameCounts {
  std::size_t links = 0, parts = 0, fingers = 0;
};

/// Throws DescriptionError where the cell has no such frame.
FrameRef parse_frame(const JsonReader& json, const FrameCounts& counts);

}  // namespace robotcell
