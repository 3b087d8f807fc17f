// An instance's whole state (FMUState), and its bytes.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fmu/fmi/phase.h"
#include "fmu/model/cell.h"

namespace robotcell::fmi {

struct Snapshot {
  explicit Snapshot(const CellLayout& layout) : inputs(layout) {}

  Phase phase = Phase::kInstantiated;
  double start_time = 0;
  double stop_time = 0;  // infinite when not defined
  double communication_time = 0;
  Events events = 0;  // of the last step, and not dealt with yet
  CellParameters parameters;
  CellInputs inputs;
  std::uint64_t description_hash = 0;  // of the cell's JSON, 0 while there is no cell
  std::optional<CellState> cell;
};

std::vector<std::uint8_t> serialize(Snapshot& snapshot, std::string token);

/// Throws std::invalid_argument when the bytes are not a whole, unaltered state of an FMU with this token.
Snapshot deserialize(const std::uint8_t* bytes, std::size_t size, const CellLayout& layout,
                     const std::string& token);

/// Whether a cell made with the one is a cell made with the other.
bool same_parameters(CellParameters a, CellParameters b);

/// FNV-1a of a byte sequence.
std::uint64_t hash_of(const std::uint8_t* bytes, std::size_t size);

}  // namespace robotcell::fmi
