// SPDX-License-Identifier: Apache-2.0
#include "transport/topic.h"

#include <cstdlib>

#include <cxxabi.h>

namespace xauto::detail {

std::string demangle(const char* name) {
  int status = 0;
  char* text = abi::__cxa_demangle(name, nullptr, nullptr, &status);
  std::string result = status == 0 ? text : name;
  std::free(text);
  return result;
}

}  // namespace xauto::detail
