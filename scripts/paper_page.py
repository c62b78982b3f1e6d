# SPDX-License-Identifier: Apache-2.0
"""The page of `make paper`, from its paper.json."""


def page(data):
    return data["kind"]


def markdown(data):
    return data["kind"]
