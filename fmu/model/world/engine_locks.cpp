#include "fmu/model/world/engine_locks.h"

namespace robotcell {

__attribute__((visibility("default"))) std::mutex& building_mutex() {
  static std::mutex mutex;
  return mutex;
}

__attribute__((visibility("default"))) std::mutex& mesh_collision_mutex() {
  static std::mutex mutex;
  return mutex;
}

}  // namespace robotcell
