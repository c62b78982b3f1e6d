# SPDX-License-Identifier: Apache-2.0
# One warning level for all of our code. Errors in CI only (XAUTO_WERROR), so that a newer compiler
# on a user's machine does not break the build.
option(XAUTO_WERROR "Treat warnings as errors" OFF)
# Designated initialisers leave out members on purpose: the others have defaults.
add_compile_options(-Wall -Wextra -Wconversion -Wshadow $<$<COMPILE_LANGUAGE:CXX>:-Wnon-virtual-dtor> -Wno-missing-field-initializers)
if(XAUTO_WERROR)
  add_compile_options(-Werror)
endif()
# GCC 12 reports false -Wmaybe-uninitialized through std::optional and std::variant under -O2.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # ... and -Wrestrict through std::string concatenation (GCC bug 105651).
  add_compile_options(-Wno-maybe-uninitialized -Wno-restrict)
endif()
# A class of one .cc file with a member from that file's anonymous namespace: right, but GCC sees no longer that it is one file's.
if(CMAKE_UNITY_BUILD AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  add_compile_options($<$<COMPILE_LANGUAGE:CXX>:-Wno-subobject-linkage>)
endif()
# Clang counts signs among the conversions, and sees what the standard library calls within itself.
if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
  add_compile_options(-Wno-sign-conversion -Wno-deprecated-declarations)
  # What a lock guards is touched with the lock held (lib/base/thread_safety.h): the sanitizers' builds compile all of lib/.
  add_compile_options($<$<COMPILE_LANGUAGE:CXX>:-Wthread-safety> $<$<COMPILE_LANGUAGE:CXX>:-Werror=thread-safety>)
endif()
