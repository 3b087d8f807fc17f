// Impulses at contacts and joints, with friction cones.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace robotcell {

/// Finds x with w = A x - b such that, at every contact, 0 <= x_n _|_ w_n >= 0 and the friction x_t minimises
/// x_t . w_t in the disc of radius friction * x_n (maximum dissipation: it opposes slip), and that every
/// other row obeys lo <= x <= hi with w = 0 between the bounds. Rows come as the dynamics engine makes them:
/// a contact is a normal row and two friction rows that refer to it.
class CoulombProblem {
 public:
  void set(int n, const double* a, const double* b, const double* lo, const double* hi, const int* findex);

  /// Largest violation of the conditions by x, as an impulse.
  double violation(const Eigen::VectorXd& x) const;

  /// Improves x by projected Gauss-Seidel sweeps over contacts and rows, until the sweeps change nothing.
  void improve(Eigen::VectorXd& x) const;

 private:
  struct Contact {
    Eigen::Index row = 0;
    double friction = 0;
    double stiffest = 0;  // largest eigenvalue of the friction rows' block
  };
  struct Bounded {
    Eigen::Index row = 0;
    double lo = 0, hi = 0;
  };

  double mass_inverse(Eigen::Index row) const;
  double excess(Eigen::Index row, const Eigen::VectorXd& x) const { return a_.row(row).dot(x) - b_[row]; }
  double normal_update(const Contact& contact, const Eigen::VectorXd& x) const;
  Eigen::Vector2d friction_update(const Contact& contact, const Eigen::VectorXd& x) const;
  double bounded_update(const Bounded& bounded, const Eigen::VectorXd& x) const;

  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> a_;
  Eigen::VectorXd b_;
  std::vector<Contact> contacts_;
  std::vector<Bounded> bounded_;
};

}  // namespace robotcell
