// Locks shared by all copies of the FMU in a process.
//
// FMUs of the same build that are unpacked in different folders have separate binaries but share the engine's
// libraries, and with them their process-wide state. A mutex in the FMU's own binary would not protect it, so
// the mutexes are in a library that is shared the same way.
#pragma once

#include <mutex>

namespace robotcell {

/// The engine has process-wide registers of frames, and ODE a reference count: only one instance at a time
/// may be created or destroyed.
std::mutex& building_mutex();

/// ODE as distributed has one mesh collider per process, in spite of its per-thread data: concurrent mesh
/// collisions would corrupt each other's contacts.
std::mutex& mesh_collision_mutex();

}  // namespace robotcell
