# SPDX-License-Identifier: Apache-2.0
# xauto_add_messages(TARGET FILE... [ROOTS FOLDER...] [MAX_BYTES N]): TARGET can use the message types of these .msg and .idl files,
# and those that they need: of sensor_msgs/msg/Image.msg it is sensor_msgs::msg::Image in <sensor_msgs/msg/image.h>.
#   FILE       <package>/msg/<Type>.msg or .idl: below this CMakeLists.txt, a folder of ROOTS, or what XAuto has of its own
#   MAX_BYTES  of one encoded message of the named types between processes and from DDS; 8 MiB unless said
# docs/interop.md has the rest. The headers are made where the target is built, by Python 3.
find_package(Python3 3.8 QUIET COMPONENTS Interpreter)
if(NOT XAUTO_MESSAGES) # installed, it lies beside this file
  set(XAUTO_MESSAGES ${CMAKE_CURRENT_LIST_DIR}/messages)
endif()

function(xauto_add_messages target)
  cmake_parse_arguments(ARG "" "MAX_BYTES" "ROOTS" ${ARGN})
  if(NOT TARGET ${target})
    message(FATAL_ERROR "xauto_add_messages: ${target} is no target")
  endif()
  get_target_property(kind ${target} TYPE)
  if(kind STREQUAL "INTERFACE_LIBRARY")
    message(FATAL_ERROR "xauto_add_messages: ${target} is an interface library, and nothing is made where it is; name what links it")
  elseif(NOT ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "xauto_add_messages: no .msg or .idl file for ${target}")
  elseif(NOT Python3_Interpreter_FOUND)
    message(FATAL_ERROR "xauto_add_messages: Python 3.8 or later is needed: install python3")
  endif()
  set(generator ${Python3_EXECUTABLE} -B ${XAUTO_MESSAGES}/generate.py)
  foreach(root ${CMAKE_CURRENT_SOURCE_DIR} ${ARG_ROOTS} ${XAUTO_MESSAGES}/interfaces)
    get_filename_component(root ${root} ABSOLUTE)
    list(APPEND roots --root ${root})
  endforeach()
  execute_process(COMMAND ${generator} ${roots} list ${ARG_UNPARSED_ARGUMENTS}
                  OUTPUT_VARIABLE types ERROR_VARIABLE why RESULT_VARIABLE failed OUTPUT_STRIP_TRAILING_WHITESPACE)
  if(failed)
    message(FATAL_ERROR "xauto_add_messages: ${why}")
  endif()
  # A header that another call has asked for is made there.
  set(out ${CMAKE_CURRENT_BINARY_DIR}/xauto_messages/${target})
  get_target_property(known ${target} XAUTO_MESSAGES)
  string(REPLACE "\n" ";" types "${types}")
  foreach(type ${types})
    string(REPLACE "|" ";" type "${type}")
    list(GET type 1 header)
    list(GET type 2 file)
    list(APPEND files ${file})
    if(NOT header IN_LIST known)
      list(APPEND headers ${out}/${header})
      list(APPEND only --only ${header})
      set_property(TARGET ${target} APPEND PROPERTY XAUTO_MESSAGES ${header})
    endif()
  endforeach()
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${files})
  if(NOT headers)
    return()
  endif()
  if(ARG_MAX_BYTES)
    list(APPEND roots --max-bytes ${ARG_MAX_BYTES})
  endif()
  file(GLOB sources ${XAUTO_MESSAGES}/*.py)
  add_custom_command(OUTPUT ${headers}
                     COMMAND ${generator} ${roots} --out ${out} ${only} make ${ARG_UNPARSED_ARGUMENTS}
                     DEPENDS ${files} ${sources} COMMENT "Messages of ${target}" VERBATIM)
  target_sources(${target} PRIVATE ${headers})
  target_include_directories(${target} SYSTEM PUBLIC ${out}) # our warnings are not the user's
endfunction()
