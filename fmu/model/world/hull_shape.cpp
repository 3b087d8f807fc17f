#include "fmu/model/world/hull_shape.h"

#include <assimp/scene.h>

#include <algorithm>
#include <cmath>
#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/MeshShape.hpp>
#include <memory>
#include <optional>

namespace robotcell {
namespace {

aiVector3D to_assimp(const Eigen::Vector3d& v) {
  return {static_cast<ai_real>(v.x()), static_cast<ai_real>(v.y()), static_cast<ai_real>(v.z())};
}

/// Every face gets its own three vertices. DART passes the list of normals to ODE, which reads entry i as the
/// normal of face i; with three vertices per face the list is long enough.
aiMesh* make_mesh(const Hull& hull) {
  auto mesh = std::make_unique<aiMesh>();
  mesh->mPrimitiveTypes = aiPrimitiveType_TRIANGLE;
  mesh->mNumFaces = static_cast<unsigned>(hull.faces.size());
  mesh->mNumVertices = 3 * mesh->mNumFaces;
  mesh->mFaces = new aiFace[mesh->mNumFaces];
  mesh->mVertices = new aiVector3D[mesh->mNumVertices];
  mesh->mNormals = new aiVector3D[mesh->mNumVertices];
  for (unsigned f = 0; f < mesh->mNumFaces; ++f) {
    std::array<Eigen::Vector3d, 3> corner;
    mesh->mFaces[f].mNumIndices = 3;
    mesh->mFaces[f].mIndices = new unsigned[3];
    for (unsigned k = 0; k < 3; ++k) {
      corner[k] = hull.vertices[static_cast<std::size_t>(hull.faces[f][k])];
      mesh->mFaces[f].mIndices[k] = 3 * f + k;
      mesh->mVertices[3 * f + k] = to_assimp(corner[k]);
    }
    mesh->mNormals[f] = to_assimp((corner[1] - corner[0]).cross(corner[2] - corner[0]).normalized());
  }
  return mesh.release();
}

/// The edges of a box at its first vertex, as columns; empty where the vertices do not form a box.
std::optional<Eigen::Matrix3d> box_edges(const std::vector<Eigen::Vector3d>& vertices) {
  if (vertices.size() != 8) return std::nullopt;
  std::vector<Eigen::Vector3d> edge_vectors;
  for (std::size_t i = 1; i < 8; ++i) edge_vectors.push_back(vertices[i] - vertices[0]);
  std::sort(edge_vectors.begin(), edge_vectors.end(), [](const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    return a.squaredNorm() < b.squaredNorm();
  });
  const double tolerance = 1e-9 * edge_vectors.back().norm();
  Eigen::Matrix3d edges;
  // The two nearest vertices are neighbours; the third neighbour follows from the farthest vertex.
  edges << edge_vectors[0], edge_vectors[1], edge_vectors[6] - edge_vectors[0] - edge_vectors[1];
  const Eigen::Matrix3d products = edges.transpose() * edges;
  const bool square = std::abs(products(0, 1)) + std::abs(products(0, 2)) + std::abs(products(1, 2)) <
                      tolerance * edge_vectors.back().norm();
  if (!square || products.diagonal().minCoeff() <= 0) return std::nullopt;
  const Eigen::Vector3d lengths = products.diagonal().cwiseSqrt();
  for (const Eigen::Vector3d& vertex : edge_vectors) {
    const Eigen::Vector3d along = (edges.transpose() * vertex).cwiseQuotient(lengths);
    const bool corner = (along.cwiseMin((along - lengths).cwiseAbs()).cwiseAbs().array() < tolerance).all();
    if (!corner) return std::nullopt;
  }
  return edges;
}

}  // namespace

PlacedShape make_mesh_shape(const Hull& hull) {
  auto scene = std::make_unique<aiScene>();
  scene->mNumMeshes = 1;
  scene->mMeshes = new aiMesh* [1] { make_mesh(hull) };
  scene->mNumMaterials = 1;
  scene->mMaterials = new aiMaterial* [1] { new aiMaterial };
  scene->mRootNode = new aiNode;
  scene->mRootNode->mNumMeshes = 1;
  scene->mRootNode->mMeshes = new unsigned[1]{0};
  return {std::make_shared<dart::dynamics::MeshShape>(Eigen::Vector3d::Ones(), scene.release()),
          Eigen::Isometry3d::Identity()};
}

PlacedShape make_obstacle_shape(const Hull& hull) {
  const std::optional<Eigen::Matrix3d> edges = box_edges(hull.vertices);
  if (!edges) return make_mesh_shape(hull);
  const Eigen::Vector3d size = edges->colwise().norm();
  Eigen::Matrix3d axes = edges->array().rowwise() / size.transpose().array();
  if (axes.determinant() < 0) axes.col(2) *= -1;
  PlacedShape box{std::make_shared<dart::dynamics::BoxShape>(size), Eigen::Isometry3d::Identity()};
  box.hull_from_shape.linear() = axes;
  box.hull_from_shape.translation() = hull.vertices[0] + edges->rowwise().sum() / 2;
  return box;
}

}  // namespace robotcell
