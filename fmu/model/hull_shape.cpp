#include "fmu/model/hull_shape.h"

#include <assimp/scene.h>

#include <dart/dynamics/MeshShape.hpp>
#include <memory>

namespace robotcell {
namespace {

aiVector3D to_assimp(const Eigen::Vector3d& v) {
  return {static_cast<ai_real>(v.x()), static_cast<ai_real>(v.y()), static_cast<ai_real>(v.z())};
}

/// Every face gets corners of its own. The engine hands the list of normals to ODE, which reads entry i as
/// the normal of face i: with three corners per face the list is long enough to hold the face normals in that
/// order.
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

}  // namespace

dart::dynamics::ShapePtr make_hull_shape(const Hull& hull) {
  auto scene = std::make_unique<aiScene>();
  scene->mNumMeshes = 1;
  scene->mMeshes = new aiMesh* [1] { make_mesh(hull) };
  scene->mNumMaterials = 1;
  scene->mMaterials = new aiMaterial* [1] { new aiMaterial };
  scene->mRootNode = new aiNode;
  scene->mRootNode->mNumMeshes = 1;
  scene->mRootNode->mMeshes = new unsigned[1]{0};
  return std::make_shared<dart::dynamics::MeshShape>(Eigen::Vector3d::Ones(), scene.release());
}

}  // namespace robotcell
