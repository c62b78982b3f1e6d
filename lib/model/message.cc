// SPDX-License-Identifier: Apache-2.0
#include "model/message.h"

#include <cstdlib>
#include <stdexcept>

#include <cxxabi.h>

#include "base/clock.h"
#include "base/number.h"

namespace xauto {
namespace {

std::string demangle(const char* name) {
  int status = 0;
  char* text = abi::__cxa_demangle(name, nullptr, nullptr, &status);
  std::string result = status == 0 ? text : name;
  std::free(text);
  return result;
}

/// Which of the topics it is. Throws where it is none; `type`: what it has to carry, null: whatever.
std::size_t place_of(const detail::InputData& data, const std::string& topic,
                     const std::type_info* type, const char* what) {
  for (std::size_t i = 0; data.topics != nullptr && i < data.topics->size(); ++i) {
    const detail::TopicSpec& known = (*data.topics)[i];
    if ((known.called.empty() ? known.name : known.called) != topic) continue;
    if (type != nullptr && known.type != *type)
      throw std::logic_error("topic '" + topic + "' carries " + known.type_name);
    return i;
  }
  throw std::logic_error("topic '" + topic + "' is not " + what + " this XModule");
}

const detail::ParameterNow& now_of(const detail::InputData& data,
                                   const detail::ParameterSpec& parameter) {
  for (const detail::ParameterNow& now : data.parameters)
    if (now.spec == &parameter) return now;
  throw std::logic_error("parameter '" + parameter.name + "' is declared neither by this XModule " +
                         "nor by one of its XNodes: add_parameter does that");
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

TopicHandle make_topic(const std::string& name) {
  auto spec = std::make_shared<TopicSpec>();
  spec->name = name;
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

void set_buffered(TopicSpec& topic, std::size_t info_bytes, InfoOf info, BufferOf buffer,
                  MakeBuffered make) {
  topic.buffered = {info_bytes, info, buffer, make};
}

void set_decode_into(TopicSpec& topic, DecodeInto decode) {
  topic.decode_into = decode;
}

void set_interface(TopicSpec& topic, const char* name, const char* schema, EncodedBytes bytes,
                   EncodeInto encode, StampNs stamp_ns) {
  topic.ros_type = name;
  topic.schema = schema;
  topic.encoded_bytes = bytes;
  topic.encode_into = encode;
  topic.stamp_ns = stamp_ns;
}

std::shared_ptr<void> loan(MessageMemory* memory, std::size_t bytes) {
  return memory == nullptr ? nullptr : memory->loan(bytes);
}

}  // namespace detail

Input::Input() : data_(std::make_unique<detail::InputData>()) {}
Input::~Input() = default;

const std::shared_ptr<const void>& Input::find(const std::string& topic,
                                               const std::type_info& type) const {
  const std::size_t at = place_of(*data_, topic, &type, "an input of");
  if (at >= data_->inputs)
    throw std::logic_error("topic '" + topic + "' is sampled: Input::sampled reads it");
  return data_->messages[at].message;
}

const std::shared_ptr<const void>& Input::sample(const std::string& topic,
                                                 const std::type_info& type) const {
  const std::size_t at = place_of(*data_, topic, &type, "sampled by");
  if (at < data_->inputs)
    throw std::logic_error("topic '" + topic + "' is not sampled by this XModule");
  return data_->messages[at].message;
}

std::chrono::nanoseconds Input::age_of(const std::string& topic) const {
  const detail::Envelope& read =
      data_->messages[place_of(*data_, topic, nullptr, "an input of, nor sampled by,")];
  if (read.message == nullptr) return std::chrono::nanoseconds(-1);
  const std::int64_t now = data_->began_ns != 0 ? data_->began_ns : now_ns();
  return std::chrono::nanoseconds(now - read.origin_ns);
}

std::optional<std::chrono::nanoseconds> Input::due() const {
  if (data_->due_ns == 0) return std::nullopt;
  return std::chrono::nanoseconds(data_->due_ns);
}

std::optional<std::chrono::nanoseconds> Input::result_due() const {
  if (data_->result_due_ns == 0) return std::nullopt;
  return std::chrono::nanoseconds(data_->result_due_ns);
}

bool Input::time_for(std::chrono::nanoseconds way) const {
  if (data_->due_ns == 0) return true;
  const std::int64_t now = data_->clock_ns != nullptr ? *data_->clock_ns : now_ns();
  return way.count() <= data_->due_ns - now;
}

std::chrono::nanoseconds Input::origin() const {
  return std::chrono::nanoseconds(data_->origin_ns);
}

std::uint64_t Input::sequence() const {
  return data_->sequence;
}

std::int64_t Input::integer_of(const detail::ParameterSpec& parameter) const {
  return static_cast<std::int64_t>(now_of(*data_, parameter).bits);
}

double Input::real_of(const detail::ParameterSpec& parameter) const {
  return real_of_bits(now_of(*data_, parameter).bits);
}

const std::string& Input::text_of(const detail::ParameterSpec& parameter) const {
  return now_of(*data_, parameter).text;
}

}  // namespace xauto
