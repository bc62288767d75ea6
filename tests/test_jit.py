from pinwm_drake.jit import forget_stale_kernels


def test_cached_kernels_go_when_a_kernel_source_changes(tmp_path):
    (tmp_path / "kernels" / "__pycache__").mkdir(parents=True)
    source = tmp_path / "kernels" / "inner.py"
    source.write_text("from pinwm_drake.jit import kernel  # one\n")
    cached = tmp_path / "kernels" / "__pycache__" / "outer.f-1.py311.nbi"
    cached.write_text("compiled")
    assert forget_stale_kernels(tmp_path)  # no hash yet: nothing is known about the cache
    assert not cached.exists()
    cached.write_text("compiled")
    assert not forget_stale_kernels(tmp_path)
    assert cached.exists()
    (tmp_path / "other.py").write_text("x = 1\n")  # not a kernel
    assert not forget_stale_kernels(tmp_path)
    source.write_text("from pinwm_drake.jit import kernel\nfrom pinwm_drake import (\n    other,\n)\n")
    assert forget_stale_kernels(tmp_path)
    cached.write_text("compiled")
    (tmp_path / "other.py").write_text("x = 2\n")  # a constant of the kernel
    assert forget_stale_kernels(tmp_path)
    assert not cached.exists()
    cached.write_text("compiled")
    source.write_text("from pinwm_drake.jit import kernel  # two\n")
    assert forget_stale_kernels(tmp_path)
    assert not cached.exists()
