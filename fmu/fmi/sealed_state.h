// Frame of serialized states: token of the FMU, layout of the state, and a checksum.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/archive.h"

namespace robotcell::fmi {

/// FNV-1a hash of a byte sequence.
std::uint64_t hash_of(const std::uint8_t* bytes, std::size_t size);

/// A writer that has written the head of a state.
Writer sealed_writer(const std::string& token, std::uint64_t layout);
/// The bytes of a state with their checksum.
std::vector<std::uint8_t> sealed(Writer& writer);

/// A reader behind the head of a state. Throws std::invalid_argument where the bytes are not a complete,
/// unaltered state of an FMU with this token and layout of states.
Reader unsealed(const std::uint8_t* bytes, std::size_t size, const std::string& token, std::uint64_t layout);
/// Throws std::invalid_argument where bytes are left.
void check_end(const Reader& reader);

}  // namespace robotcell::fmi
