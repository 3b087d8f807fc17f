// Bounds of the numbers that a cell accepts. Far beyond them the collision engine ends the process.
#pragma once

namespace robotcell {

constexpr double kMaxCoordinate = 1000;  // m; of positions, lengths, and components of gravity (m/s^2)
constexpr double kMaxAngle = 629;        // rad; of deviations as built: 100 turns
constexpr double kMaxFrequency = 1e6;    // Hz; of vibrations
constexpr double kMaxFriction = 1e6;     // coefficient of Coulomb friction

}  // namespace robotcell
