// Bounds of the numbers that a cell accepts. Far beyond them the collision engine ends the process.
#pragma once

namespace robotcell {

constexpr double kMaxCoordinate = 1000;  // m; of positions, lengths, and components of gravity (m/s^2)
constexpr double kMaxFriction = 1e6;     // coefficient of Coulomb friction

}  // namespace robotcell
