// SPDX-License-Identifier: Apache-2.0
#include "model/message.h"

#include <cstdlib>
#include <stdexcept>

#include <cxxabi.h>

namespace xauto {
namespace {

std::string demangle(const char* name) {
  int status = 0;
  char* text = abi::__cxa_demangle(name, nullptr, nullptr, &status);
  std::string result = status == 0 ? text : name;
  std::free(text);
  return result;
}

}  // namespace

namespace detail {

std::shared_ptr<TopicSpec> make_topic(const std::string& name, const std::type_info& type) {
  auto spec = std::make_shared<TopicSpec>();
  spec->name = name;
  spec->type = type;
  spec->type_name = demangle(type.name());
  return spec;
}

void set_codec(TopicSpec& topic, Encode encode, Decode decode) {
  topic.encode = encode;
  topic.decode = decode;
}

void set_max_bytes(TopicSpec& topic, std::size_t bytes) {
  topic.max_bytes = bytes;
}

void set_plain_bytes(TopicSpec& topic, std::size_t bytes) {
  topic.plain_bytes = bytes;
}

std::shared_ptr<void> loan(MessageMemory* memory, std::size_t bytes) {
  return memory == nullptr ? nullptr : memory->loan(bytes);
}

}  // namespace detail

Input::Input() : data_(std::make_unique<detail::InputData>()) {}
Input::~Input() = default;

const std::shared_ptr<const void>& Input::find(const std::string& topic,
                                               const std::type_info& type) const {
  for (std::size_t i = 0; data_->topics != nullptr && i < data_->topics->size(); ++i) {
    const detail::TopicSpec& known = (*data_->topics)[i];
    if (known.name != topic) continue;
    if (known.type != type)
      throw std::logic_error("topic '" + topic + "' carries " + known.type_name);
    if (i >= data_->inputs)
      throw std::logic_error("topic '" + topic + "' is sampled: Input::sampled reads it");
    return data_->messages[i].message;
  }
  throw std::logic_error("topic '" + topic + "' is not an input of this XModule");
}

const std::shared_ptr<const void>& Input::sample(const std::string& topic,
                                                 const std::type_info& type) const {
  for (std::size_t i = data_->inputs; data_->topics != nullptr && i < data_->topics->size(); ++i) {
    const detail::TopicSpec& known = (*data_->topics)[i];
    if (known.name != topic) continue;
    if (known.type != type)
      throw std::logic_error("topic '" + topic + "' carries " + known.type_name);
    return data_->messages[i].message;
  }
  throw std::logic_error("topic '" + topic + "' is not sampled by this XModule");
}

std::chrono::nanoseconds Input::age_of(const std::string& topic) const {
  for (std::size_t i = 0; data_->topics != nullptr && i < data_->topics->size(); ++i) {
    if ((*data_->topics)[i].name != topic) continue;
    const detail::Envelope& read = data_->messages[i];
    return std::chrono::nanoseconds(read.message == nullptr ? -1
                                                            : data_->began_ns - read.origin_ns);
  }
  throw std::logic_error("topic '" + topic + "' is neither an input nor sampled by this XModule");
}

std::chrono::nanoseconds Input::origin() const {
  return std::chrono::nanoseconds(data_->origin_ns);
}

std::uint64_t Input::sequence() const {
  return data_->sequence;
}

}  // namespace xauto
