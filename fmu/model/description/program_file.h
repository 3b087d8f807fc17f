// Reading of programs for the controller from saved plans.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "fmu/control/program.h"

namespace robotcell {

/// Reads the segments of a saved plan (JSON, format 2) for an arm with this number of joints, with a
/// set-point in every controller cycle; other keys are ignored. Throws DescriptionError that names file, key
/// and value.
std::shared_ptr<const control::Program> read_program(const std::string& path, std::size_t joints,
                                                     std::size_t axes, std::int64_t cycle_us);

}  // namespace robotcell
