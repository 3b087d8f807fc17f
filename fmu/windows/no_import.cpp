// What DART's mesh shapes need of assimp's importer, for a library without importers: no file is imported.
#include <assimp/cimport.h>
#include <assimp/scene.h>

#include <new>

namespace Assimp::Intern {

void* AllocateFromAssimpHeap::operator new(std::size_t size) { return ::operator new(size); }
void AllocateFromAssimpHeap::operator delete(void* data) { ::operator delete(data); }

}  // namespace Assimp::Intern

extern "C" {

const aiScene* aiImportFileExWithProperties(const char*, unsigned, aiFileIO*, const aiPropertyStore*) {
  return nullptr;
}
const aiScene* aiApplyPostProcessing(const aiScene*, unsigned) { return nullptr; }
void aiReleaseImport(const aiScene* scene) { delete scene; }
aiPropertyStore* aiCreatePropertyStore() { return nullptr; }
void aiReleasePropertyStore(aiPropertyStore*) {}
void aiSetImportPropertyInteger(aiPropertyStore*, const char*, int) {}

}  // extern "C"
