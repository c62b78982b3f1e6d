// SPDX-License-Identifier: Apache-2.0
#include "transport/cyclonedds/sample.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <new>
#include <utility>

#include <dds/ddsi/q_radmin.h>

#include "base/pi_mutex.h"
#include "base/thread_safety.h"

namespace xauto::transport {
namespace {

const Sample& of(const ddsi_serdata* data) {
  return *static_cast<const Sample*>(data);
}

struct Type : ddsi_sertype {
  Replaced replaced;
};
const Type& of(const ddsi_sertype* type) {
  return *static_cast<const Type*>(type);
}

constexpr std::size_t filled_up(std::size_t size) {
  return (size + 3) / 4 * 4;
}

/// Memory of large samples that nobody has any more, for those to come: see kept_messages.h.
class Spare {
 public:
  static constexpr std::size_t kLeast = std::size_t{64} << 10;  ///< smaller ones are not kept

  /// Room for `bytes`; `room` says for how many. Null: no memory.
  void* take(std::size_t bytes, std::size_t& room) {
    if (bytes >= kLeast) {
      const Guard lock(mutex_);
      for (Block& block : blocks_)
        // What is far too large waits for who needs it.
        if (block.at != nullptr && block.room >= bytes && block.room / 2 <= bytes) {
          room = block.room;
          return std::exchange(block.at, nullptr);
        }
    }
    room = bytes;
    return std::malloc(bytes);
  }
  /// Of `take`.
  void give(void* at, std::size_t room) {
    if (room >= kLeast) {
      const Guard lock(mutex_);
      auto block = std::find_if(blocks_.begin(), blocks_.end(),
                                [](const Block& b) { return b.at == nullptr; });
      // In turns, so that what fits nobody goes, too.
      if (block == blocks_.end()) block = blocks_.begin() + next_++ % kBlocks;
      std::swap(block->at, at);
      block->room = room;
    }
    std::free(at);
  }

 private:
  struct Block {
    void* at = nullptr;
    std::size_t room = 0;
  };
  PiMutex mutex_;
  static constexpr std::size_t kBlocks = 4;
  std::array<Block, kBlocks> blocks_ XAUTO_GUARDED_BY(mutex_);
  std::size_t next_ XAUTO_GUARDED_BY(mutex_) = 0;
};

/// Cyclone's threads may still let go of samples while the process ends.
Spare& spare() {
  static auto& spare = *new Spare;
  return spare;
}

Sample* allocate(const ddsi_sertype* type, ddsi_serdata_kind kind, std::size_t size) {
  if (size > std::numeric_limits<std::uint32_t>::max() - 3) return nullptr;
  std::size_t room = 0;
  void* at = spare().take(sizeof(Sample) + filled_up(size), room);
  if (at == nullptr) return nullptr;
  auto* sample = new (at) Sample{};
  ddsi_serdata_init(sample, type, kind);
  sample->size = size;
  sample->room = room;
  std::byte* bytes = sample->bytes().data();
  std::memset(bytes + size, 0, filled_up(size) - size);
  return sample;
}

/// Where the padding is the sender's, it has said how much (XTypes 1.3, 7.6.3.1.2).
void cut_padding(Sample& sample) {
  if (sample.size < 4) return;
  const auto padding = static_cast<std::size_t>(sample.bytes()[3]) & 3U;
  if (sample.size >= 4 + padding) sample.size -= padding;
}

std::uint32_t get_size(const ddsi_serdata* data) {
  return static_cast<std::uint32_t>(filled_up(of(data).size));
}

/// What comes from elsewhere.
Sample* allocate_received(const ddsi_sertype* type, ddsi_serdata_kind kind, std::size_t size) {
  Sample* sample = allocate(type, kind, size);
  if (sample != nullptr && kind == SDK_DATA) sample->replaced = of(type).replaced;
  return sample;
}

/// From the network: fragments in order, which may overlap.
ddsi_serdata* from_ser(const ddsi_sertype* type, ddsi_serdata_kind kind, const nn_rdata* fragment,
                       std::size_t size) {
  Sample* sample = allocate_received(type, kind, size);
  if (sample == nullptr) return nullptr;
  std::byte* to = sample->bytes().data();
  std::size_t have = 0;
  for (; fragment != nullptr; fragment = fragment->nextfrag) {
    const std::size_t end = std::min<std::size_t>(fragment->maxp1, size);
    if (end <= have || fragment->min > have) continue;
    const unsigned char* payload =
        NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_PAYLOAD_OFF(fragment));
    std::memcpy(to + have, payload + (have - fragment->min), end - have);
    have = end;
  }
  sample->size = have;  // all of it, unless Cyclone has left a gap
  cut_padding(*sample);
  return sample;
}

/// From this process: another type's, or somebody's who only forwards.
ddsi_serdata* from_ser_iov(const ddsi_sertype* type, ddsi_serdata_kind kind,
                           ddsrt_msg_iovlen_t pieces, const ddsrt_iovec_t* piece,
                           std::size_t size) {
  Sample* sample = allocate_received(type, kind, size);
  if (sample == nullptr) return nullptr;
  std::byte* to = sample->bytes().data();
  std::size_t have = 0;
  for (ddsrt_msg_iovlen_t i = 0; i < pieces && have < size; ++i) {
    const std::size_t bytes = std::min<std::size_t>(piece[i].iov_len, size - have);
    std::memcpy(to + have, piece[i].iov_base, bytes);
    have += bytes;
  }
  sample->size = have;
  cut_padding(*sample);
  return sample;
}

// Without keys there is one instance, and nothing to say about it.
ddsi_serdata* from_keyhash(const ddsi_sertype* type, const ddsi_keyhash*) {
  return allocate(type, SDK_KEY, 0);
}
ddsi_serdata* to_untyped(const ddsi_serdata* data) {
  Sample* sample = allocate(data->type, SDK_KEY, 0);
  if (sample != nullptr) sample->type = nullptr;
  return sample;
}
bool untyped_to_sample(const ddsi_sertype*, const ddsi_serdata*, void*, void**, void*) {
  return true;
}
bool equal_key(const ddsi_serdata*, const ddsi_serdata*) {
  return true;
}
void get_keyhash(const ddsi_serdata*, ddsi_keyhash* hash, bool) {
  std::memset(hash, 0, sizeof *hash);
}

void to_ser(const ddsi_serdata* data, std::size_t offset, std::size_t bytes, void* to) {
  std::memcpy(to, of(data).bytes().data() + offset, bytes);
}
/// What is sent is sent from here.
ddsi_serdata* to_ser_ref(const ddsi_serdata* data, std::size_t offset, std::size_t bytes,
                         ddsrt_iovec_t* ref) {
  ref->iov_base = const_cast<std::byte*>(of(data).bytes().data() + offset);
  ref->iov_len = bytes;
  return ddsi_serdata_ref(data);
}
void to_ser_unref(ddsi_serdata* data, const ddsrt_iovec_t*) {
  ddsi_serdata_unref(data);
}

// There are no C structs: nobody calls dds_write or dds_take on these topics.
ddsi_serdata* from_sample(const ddsi_sertype* type, ddsi_serdata_kind kind, const void*) {
  return kind == SDK_DATA ? nullptr : allocate(type, kind, 0);  // Cyclone's own, of a key
}
bool to_sample(const ddsi_serdata*, void*, void**, void*) {
  return false;
}

void free_sample(ddsi_serdata* data) {
  auto* sample = static_cast<Sample*>(data);
  if (sample->replaced != nullptr && !sample->taken.load()) sample->replaced->fetch_add(1);
  const std::size_t room = sample->room;
  sample->~Sample();
  spare().give(sample, room);
}
std::size_t print(const ddsi_sertype*, const ddsi_serdata* data, char* to, std::size_t size) {
  const int length = std::snprintf(to, size, "%zu bytes", of(data).size);
  return length < 0 ? 0 : static_cast<std::size_t>(length);
}

#ifdef DDS_HAS_SHM
// Cyclone's shared memory is turned off where we join its domain (dds_bridge.cc). Where the app has
// joined before, with it, a message that comes so is none of ours, and refused.
std::uint32_t get_sample_size(const ddsi_serdata* data) {
  return data->type->iox_size;
}
ddsi_serdata* from_iox(const ddsi_sertype* type, ddsi_serdata_kind kind, void*, void*) {
  return allocate(type, kind, 0);
}
#endif

const ddsi_serdata_ops kSampleOps = {equal_key,       get_size,    from_ser,    from_ser_iov,
                                     from_keyhash,    from_sample, to_ser,      to_ser_ref,
                                     to_ser_unref,    to_sample,   to_untyped,  untyped_to_sample,
                                     free_sample,     print,       get_keyhash,
#ifdef DDS_HAS_SHM
                                     get_sample_size, from_iox
#endif
};

void free_type(ddsi_sertype* type) {
  ddsi_sertype_fini(type);
  delete static_cast<Type*>(type);
}
void zero_samples(const ddsi_sertype*, void*, std::size_t) {}
void realloc_samples(void** samples, const ddsi_sertype*, void*, std::size_t, std::size_t count) {
  std::fill(samples, samples + count, nullptr);
}
void free_samples(const ddsi_sertype*, void**, std::size_t, dds_free_op_t) {}
bool equal_types(const ddsi_sertype* one, const ddsi_sertype* other) {
  return of(one).replaced == of(other).replaced;  // the names are, and there is nothing else
}
std::uint32_t hash_type(const ddsi_sertype*) {
  return 0;
}
std::size_t serialized_size(const ddsi_sertype*, const void*) {
  return std::numeric_limits<std::size_t>::max();
}
bool serialize_into(const ddsi_sertype*, const void*, void*, std::size_t) {
  return false;
}

// No type information: who compares, compares the names, as ROS 2 up to now.
const ddsi_sertype_ops kTypeOps = {ddsi_sertype_v0, nullptr,       free_type,   zero_samples,
                                   realloc_samples, free_samples,  equal_types, hash_type,
                                   nullptr,         nullptr,       nullptr,     nullptr,
                                   serialized_size, serialize_into};

}  // namespace

ddsi_sertype* make_type(const std::string& name, Replaced replaced) {
  auto* type = new Type{};
  type->replaced = std::move(replaced);
  ddsi_sertype_init_flags(type, name.c_str(), &kTypeOps, &kSampleOps,
                          DDSI_SERTYPE_FLAG_TOPICKIND_NO_KEY);
  type->allowed_data_representation = DDS_DATA_REPRESENTATION_FLAG_XCDR1;
  return type;
}

SamplePtr make_sample(const ddsi_sertype& type, std::size_t size) {
  return SamplePtr(allocate(&type, SDK_DATA, size));
}

}  // namespace xauto::transport
