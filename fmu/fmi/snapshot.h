// Complete state of an instance (FMUState), and its serialization.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fmu/fmi/instance.h"
#include "fmu/model/cell.h"
#include "fmu/model/start_inputs.h"

namespace robotcell::fmi {

/// Flags of inputs that start at the home pose (`home_inputs`).
using HomeInputFlags = std::array<bool, kHomeInputs>;

struct Snapshot : SavedState {
  explicit Snapshot(const CellLayout& layout) : inputs(layout) {}
  void assign(const SavedState& other) override { *this = dynamic_cast<const Snapshot&>(other); }

  Phase phase = Phase::kInstantiated;
  double start_time = 0;
  double stop_time = 0;  // infinite where not defined
  double communication_time = 0;
  Events events = 0;  // of the last step, not yet handled
  CellParameters parameters;
  CellInputs inputs;
  HomeInputFlags home_inputs_set{};
  std::uint64_t description_hash = 0;  // of the cell's JSON; 0 without a cell
  std::optional<CellState> cell;
};

/// Identifies the layout of serialized states: a hash of the names and types of all members.
std::uint64_t state_layout();

std::vector<std::uint8_t> serialize(const Snapshot& snapshot, const std::string& token);

/// Throws std::invalid_argument where the bytes are not a complete, unaltered state of an FMU with this token
/// and layout of states.
Snapshot deserialize(const std::uint8_t* bytes, std::size_t size, const CellLayout& layout,
                     const std::string& token);

/// Whether two sets of parameters are equal.
bool same_parameters(CellParameters a, CellParameters b);

}  // namespace robotcell::fmi
