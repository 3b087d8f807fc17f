// Generates modelDescription.xml of both FMI versions from the variable table.
#pragma once

#include <string>

#include "fmu/fmi/variable_table.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell::fmi {

struct DescriptionOptions {
  int version = 3;  // 2 or 3
  /// Include the clock of the trigger records (FMI 3). Off by default: importers without support for clocks
  /// crash on it, and event mode works without.
  bool clock = false;
  /// Describe the path ahead of the controller: 64 points of all axes, as an array in FMI 3. Off by default:
  /// it has as many values as everything else, and is evaluated where it is read.
  bool ahead = false;
  /// Describe arrays of all records that became complete in a communication step (FMI 3).
  bool records = false;
  /// Merge indexed scalars into arrays (FMI 3). Off by default: few importers support arrays, and some read
  /// zeros.
  bool arrays = false;
  /// Integers instead of enumerations, with the same functions. Off by default; libcosim and ecos do not know
  /// enumerations.
  bool integers = false;
  /// System requirements of the binaries, for the description text; may be empty.
  std::string needs;
};

/// What a model description states beside the variables.
struct ModelHead {
  const char* name;  // of model and library
  std::string description;
  double step = 0;           // s, default communication step
  double internal_step = 0;  // s, fixed internal step; 0: none
  bool has_events = true;    // event mode, early return and intermediate updates (FMI 3)
};

std::string model_description(const ModelHead& model, VariableTable table, const DescriptionOptions& options);

/// Name and step size come from the cell, everything else from the variable table.
std::string model_description(const CellDescription& cell, const DescriptionOptions& options);

}  // namespace robotcell::fmi
