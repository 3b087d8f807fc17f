// Contact and joint impulses with friction cones.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace robotcell {

/// Finds impulses x with w = A x - b, A being the Delassus operator (inverse mass matrix in constraint
/// space), such that at every contact 0 <= x_n _|_ w_n >= 0 and the friction impulse x_t minimises x_t . w_t
/// in the disc of radius friction * x_n (maximum dissipation), and that every other row obeys lo <= x <= hi
/// with w = 0 between the bounds. Rows are those of the dynamics engine: a contact is a normal row and two
/// friction rows that refer to it.
class CoulombProblem {
 public:
  void set(int n, const double* a, const double* b, const double* lo, const double* hi, const int* findex);

  /// Largest violation of the conditions by x, expressed as an impulse.
  double violation(const Eigen::VectorXd& x) const;

  /// Refines x by projected Gauss-Seidel sweeps over all contacts and rows until convergence.
  bool run_gauss_seidel(Eigen::VectorXd& x) const;

 private:
  struct Contact {
    Eigen::Index row = 0;
    double friction = 0;
    double largest_eigenvalue =
        0;  // of the friction rows' block of the Delassus operator: the step size of the projection
  };
  struct Bounded {
    Eigen::Index row = 0;
    double lo = 0, hi = 0;
  };

  double inverse_mass(Eigen::Index row) const;
  double residual(Eigen::Index row, const Eigen::VectorXd& x) const {
    return delassus_.row(row).dot(x) - b_[row];
  }
  double normal_update(const Contact& contact, const Eigen::VectorXd& x) const;
  Eigen::Vector2d friction_update(const Contact& contact, const Eigen::VectorXd& x) const;
  double bounded_update(const Bounded& bounded, const Eigen::VectorXd& x) const;

  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> delassus_;
  Eigen::VectorXd b_;
  std::vector<Contact> contacts_;
  std::vector<Bounded> bounded_;
};

}  // namespace robotcell
