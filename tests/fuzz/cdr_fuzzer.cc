// SPDX-License-Identifier: Apache-2.0
// A message of a .msg file from outside: bytes of DDS. What is taken must be what is written again.
#include <cstdlib>
#include <span>
#include <stdexcept>

#include <test_msgs/msg/all_kinds.h>
#include <test_msgs/msg/wide.h>
#include <vision_msgs/msg/detection2_d_array.h>

namespace {

template <class T>
void check(std::span<const std::byte> bytes) {
  T message;
  try {
    message = xauto::Codec<T>::decode(bytes);
  } catch (const std::runtime_error&) {
    return;
  }
  // As bytes: a NaN is no equal of itself.
  const auto encoded = xauto::Codec<T>::encode(message);
  if (xauto::Codec<T>::encode(xauto::Codec<T>::decode(encoded)) != encoded) std::abort();
}

}  // namespace

/// The first byte chooses the type.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span<const std::byte> bytes{reinterpret_cast<const std::byte*>(data) + 1, size - 1};
  switch (data[0] % 3) {
    case 0:
      check<test_msgs::msg::AllKinds>(bytes);
      break;
    case 1:
      check<vision_msgs::msg::Detection2DArray>(bytes);
      break;
    default:
      check<test_msgs::msg::Wide>(bytes);
  }
  return 0;
}
