// Locks that all copies of the FMU in a process share.
//
// FMUs of the same build in one process, unpacked in different folders, have a binary each but share the
// engine's libraries, and with them the state that these keep for the whole process. A mutex inside the FMU's
// own binary would not keep two of them apart, so the mutexes lie in a library that is shared the same way.
#pragma once

#include <mutex>

namespace robotcell {

/// The engine keeps process-wide registers of frames, and ODE a counter of its users: one instance at a time
/// may be built or torn down.
std::mutex& building_mutex();

/// ODE as distributed keeps one mesh collider for the whole process, whatever its per-thread data promises:
/// two instances that collide meshes at once would disturb each other's contacts.
std::mutex& mesh_collision_mutex();

}  // namespace robotcell
