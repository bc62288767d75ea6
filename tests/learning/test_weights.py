# SPDX-License-Identifier: MIT
import pytest
import torch

from pinwm_drake.learning.weights import has_bfloat16


@pytest.mark.parametrize("instructions", ["_is_avx512_bf16_supported", "_is_amx_tile_supported"])
def test_bfloat16_is_asked_for_where_a_cpu_has_the_instructions(monkeypatch, instructions):
    for name in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"):
        monkeypatch.setattr(torch.cpu, name, lambda: False)
    assert not has_bfloat16("cpu")
    monkeypatch.setattr(torch.cpu, instructions, lambda: True)
    assert has_bfloat16("cpu")
    assert not has_bfloat16("cuda")
