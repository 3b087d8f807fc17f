#include "fmu/fmi/sealed_state.h"

#include <cstring>
#include <stdexcept>

namespace robotcell::fmi {
namespace {

constexpr std::size_t kChecksumSize = sizeof(std::uint64_t);
constexpr const char* kRemedy = "; restore it in the FMU that saved it, or save a new state with this one";

}  // namespace

std::uint64_t hash_of(const std::uint8_t* bytes, std::size_t size) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 0x100000001b3u;
  return hash;
}

Writer sealed_writer(const std::string& token, std::uint64_t layout) {
  Writer writer;
  std::string text = token;
  exchange(writer, text);
  exchange(writer, layout);
  return writer;
}

std::vector<std::uint8_t> sealed(Writer& writer) {
  std::vector<std::uint8_t> bytes = writer.take();
  const std::uint64_t checksum = hash_of(bytes.data(), bytes.size());
  const auto* first = reinterpret_cast<const std::uint8_t*>(&checksum);
  bytes.insert(bytes.end(), first, first + kChecksumSize);
  return bytes;
}

Reader unsealed(const std::uint8_t* bytes, std::size_t size, const std::string& token, std::uint64_t layout) {
  if (bytes == nullptr || size < kChecksumSize) {
    throw std::invalid_argument("the serialized state is truncated");
  }
  const std::size_t body = size - kChecksumSize;
  std::uint64_t checksum = 0;
  std::memcpy(&checksum, bytes + body, kChecksumSize);
  if (checksum != hash_of(bytes, body)) {
    throw std::invalid_argument("the serialized state is truncated, altered or not a state: wrong checksum");
  }
  Reader reader(bytes, body);
  std::string own;
  exchange(reader, own);
  if (own != token) {
    throw std::invalid_argument("the serialized state belongs to another FMU: its token is '" + own +
                                "', expected '" + token + "'" + kRemedy);
  }
  std::uint64_t own_layout = 0;
  exchange(reader, own_layout);
  if (own_layout != layout) {
    throw std::invalid_argument(
        std::string("the serialized state has another layout, of another version of this FMU") + kRemedy);
  }
  return reader;
}

void check_end(const Reader& reader) {
  if (reader.left() == 0) return;
  throw std::invalid_argument("the serialized state has " + std::to_string(reader.left()) + " extra bytes");
}

}  // namespace robotcell::fmi
