"""PETSc presets and SciPy's solver: one answer, honest reasons, options that are used or refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene, step

from femdeform.errors import InputError
from femdeform.fem.assembly import SparseHessian
from solvers.linear.scipy_direct import SciPyDirect
from verification.benchmarks.matrix_times import matrix_times

PRESETS = ["newton-mumps", "newton-gamg", "newton-hypre", "newton-icc", "newton-ssor"]


def deck(linear_solver: dict[str, Any], order: int = 1, dim: int = 3) -> dict[str, Any]:
    return scene(
        {"b": body(block([1.0, 0.4, 0.3][:dim], [5, 2, 2][:dim]), material(E=1e5, nu=0.3), element_order=order)},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "traction", "on": "b.right", "value": [500.0, -800.0, 300.0][:dim]},
        gravity=[0.0, -1.0, 0.0][:dim],
        time=quasistatic(),
        solver={"tolerance": 1e-12},
        linear_solver=linear_solver,
    )


def system(linear_solver: dict[str, Any], dim: int = 3) -> tuple[Any, SparseHessian, Any]:
    """The linear system of a deck's first iteration and the solver that goes with it."""
    simulation = build(deck(linear_solver, dim=dim))
    problem = simulation.problem
    problem.begin_step(simulation.state, 1.0)
    return simulation.linear_solver, problem.hessian(simulation.state.x, True), -problem.gradient(simulation.state.x)


def solve(data: dict[str, Any]) -> Any:
    simulation = build(data)
    step(simulation)
    x = simulation.state.x
    simulation.linear_solver.destroy()
    return x, simulation.discretization.points


@pytest.mark.petsc
@pytest.mark.parametrize(("order", "dim"), [(1, 3), (2, 2)])
@pytest.mark.parametrize("preset", PRESETS)
def test_presets_agree_with_scipy(preset: str, order: int, dim: int) -> None:
    reference, X = solve(deck({"method": "scipy_direct"}, order, dim))
    x, _ = solve(deck({"method": "ksp", "preset": preset}, order, dim))
    assert np.abs(reference - X).max() > 0.05
    np.testing.assert_allclose(x, reference, rtol=0.0, atol=1e-8 * np.abs(reference - X).max())


@pytest.mark.petsc
@pytest.mark.parametrize("preset", PRESETS)
def test_solution_of_a_linear_system(preset: str) -> None:
    import scipy.sparse

    solver, K, b = system({"method": "ksp", "preset": preset})
    matrix = scipy.sparse.csr_matrix((K.values.copy(), K.columns, K.row_offsets), shape=(b.size, b.size))
    answer = solver.solve(K, b)
    assert answer.converged, answer.reason
    residual = matrix @ answer.x.ravel() - b.ravel()
    tolerance = 1e-12 if preset == "newton-mumps" else 1.1e-6
    assert np.linalg.norm(residual) <= tolerance * np.linalg.norm(b)
    assert np.all(answer.x[~K.free] == 0.0)
    # A second solve with the same object, and one after a reset, give the same answer.
    first = answer.x.copy()
    again = solver.solve(K, b)
    np.testing.assert_allclose(again.x, first, atol=2e-6 * np.abs(first).max())
    solver.reset()
    np.testing.assert_array_equal(solver.solve(K, b).x, first)
    solver.destroy()


@pytest.mark.petsc
def test_after_a_reset_nothing_is_remembered() -> None:
    """What a run needs to go on from a checkpoint to the bit: old values leave no trace."""
    for preset in PRESETS:
        solver, K, b = system({"method": "ksp", "preset": preset})
        fresh, K2, _ = system({"method": "ksp", "preset": preset})
        K.values[:] *= 1.7
        solver.solve(K, b)
        solver.reset()
        K.values[:] = K2.values
        np.testing.assert_array_equal(solver.solve(K, b).x, fresh.solve(K2, b).x, err_msg=preset)
        solver.destroy()
        fresh.destroy()


@pytest.mark.petsc
def test_too_few_linear_iterations_are_reported() -> None:
    options = {"ksp_max_it": 2, "ksp_rtol": 1e-12}
    solver, K, b = system({"method": "ksp", "preset": "newton-icc", "options": options})
    answer = solver.solve(K, b)
    assert not answer.converged
    assert answer.iterations == 2
    assert "max it" in answer.reason
    simulation = build(deck({"method": "ksp", "preset": "newton-icc", "options": options}))
    simulation.problem.begin_step(simulation.state, 1.0)
    result = simulation.solver.step(simulation.problem, simulation.state)
    assert not result.converged
    assert "linear solver failed" in result.reason


@pytest.mark.petsc
@pytest.mark.parametrize(
    "options",
    [{"pc_gamg_threshhold": 0.1}, {"no_such_option": True}, {"ksp_rtol": 1e-8, "mat_mumps_icntl_7": 3}],
    ids=["misspelt", "unknown", "of another solver"],
)
def test_an_option_that_petsc_does_not_use_is_an_error(options: dict[str, Any]) -> None:
    solver, K, b = system({"method": "ksp", "preset": "newton-gamg", "options": options})
    with pytest.raises(InputError, match="PETSc did not use this option") as caught:
        solver.solve(K, b)
    (fault,) = caught.value.faults
    unused = next(key for key in options if key != "ksp_rtol")
    assert fault.key == f"linear_solver.options.{unused}"
    solver.destroy()


@pytest.mark.petsc
def test_options_go_over_the_preset() -> None:
    loose = system({"method": "ksp", "preset": "newton-icc", "options": {"ksp_rtol": 1e-2}})
    tight = system({"method": "ksp", "preset": "newton-icc", "options": {"ksp_rtol": 1e-10}})
    n_loose, n_tight = (solver.solve(K, b).iterations for solver, K, b in (loose, tight))
    assert n_loose < n_tight


@pytest.mark.petsc
def test_options_of_two_solvers_do_not_mix() -> None:
    first = system({"method": "ksp", "preset": "newton-icc", "options": {"ksp_max_it": 1}})
    second = system({"method": "ksp", "preset": "newton-icc"})
    assert not first[0].solve(first[1], first[2]).converged
    assert second[0].solve(second[1], second[2]).converged
    first[0].destroy()
    assert second[0].solve(second[1], second[2]).converged


@pytest.mark.petsc
def test_multigrid_knows_the_rigid_motions() -> None:
    """With them its iterations hardly depend on the mesh; a soft, long bar needs them most."""
    from solvers.linear.ksp import load_preset

    assert load_preset("newton-gamg").near_nullspace
    solver, K, b = system({"method": "ksp", "preset": "newton-gamg"})
    assert solver.solve(K, b).iterations < 40
    modes = solver._matrix.getNearNullSpace()
    assert len(modes.getVecs()) == 6


# ------------------------------------------------------------------------------------------- SciPy


def test_scipy_reports_what_it_cannot_solve() -> None:
    solver, K, b = system({"method": "scipy_direct"}, dim=2)
    assert isinstance(solver, SciPyDirect)
    good = solver.solve(K, b)
    assert good.converged
    assert good.iterations == 1
    K.values[:] = 0.0
    singular = solver.solve(K, b)
    assert not singular.converged
    assert "singular" in singular.reason.lower()
    K.values[0] = np.nan
    assert not solver.solve(K, b).converged


@pytest.mark.petsc
@pytest.mark.parametrize(("key", "value"), [("pc_type", "foo"), ("mat_mumps_icntl_14", "abc")])
def test_an_option_value_that_petsc_refuses_is_bad_input(key: str, value: str) -> None:
    solver, K, b = system({"method": "ksp", "preset": "newton-mumps", "options": {key: value}})
    with pytest.raises(InputError, match=value):
        solver.solve(K, b)


@pytest.mark.petsc
@pytest.mark.parametrize("preset", PRESETS)
def test_a_new_pattern_makes_a_new_matrix(preset: str) -> None:
    """Contact between bodies couples other nodes: the object goes on with another sparsity, and back again."""
    data = scene(
        {
            "a": body(block([0.2, 0.2, 0.2], [2, 2, 2])),
            "b": body(block([0.2, 0.2, 0.2], [2, 2, 2], translate=[0.03, 0.205, 0.02])),
        },
        {"kind": "fixed", "on": "a.left"},
        contact={"method": "ipc"},
        linear_solver={"method": "ksp", "preset": preset},
    )
    simulation = build(data)
    problem, state = simulation.problem, simulation.state
    apart = state.copy()
    apart.x[simulation.conditions.local_nodes("b")] += 1.0
    b = np.random.default_rng(1).standard_normal(state.x.shape) * problem.free
    sizes = []
    for some in (apart, state, apart, state):
        problem.begin_step(some, 0.01)
        K = problem.hessian(some.x, True)
        sizes.append(K.values.size)
        answer = simulation.linear_solver.solve(K, b)
        assert answer.converged, answer.reason
        reference = SciPyDirect().solve(K, b)
        tolerance = 1e-9 if preset == "newton-mumps" else 1e-4
        np.testing.assert_allclose(answer.x, reference.x, atol=tolerance * np.abs(reference.x).max())
    assert sizes[0] == sizes[2] < sizes[1] == sizes[3]
    simulation.linear_solver.destroy()


@pytest.mark.petsc
def test_krylov_methods_keep_blas_on_one_thread() -> None:
    from solvers.linear import blas, coo

    library = coo.library()
    if not hasattr(library, "openblas_get_num_threads"):
        pytest.skip("PETSc's BLAS is not OpenBLAS")
    before = library.openblas_get_num_threads()
    with blas.one_thread():
        assert library.openblas_get_num_threads() == 1
    assert library.openblas_get_num_threads() == before


@pytest.mark.petsc
@pytest.mark.parametrize("preset", ["newton-icc", "newton-ssor"])
def test_a_fixed_number_of_linear_iterations_is_no_failure(preset: str) -> None:
    """Newton with limited conjugate gradients: each iteration of Newton's method takes so many, no more, no fewer."""
    options = {"ksp_max_it": 7, "ksp_convergence_test": "skip"}
    solver, K, b = system({"method": "ksp", "preset": preset, "options": options})
    answer = solver.solve(K, b)
    assert (answer.converged, answer.iterations) == (True, 7)
    # Residuals of conjugate gradients may grow; what each of them lowers is the quadratic function.
    gain = np.sum(answer.x * (b - 0.5 * matrix_times(K, answer.x)))
    exact, K, b = system({"method": "ksp", "preset": "newton-mumps"})
    most = 0.5 * np.sum(exact.solve(K, b).x * b)
    assert 0.0 < gain < (1.0 - 1e-6) * most
    data = deck({"method": "ksp", "preset": preset, "options": options})
    rows: list[Any] = []
    simulation = build({**data, "solver": {"tolerance": 1e-10, "max_iterations": 200, "hessian": "projected"}})
    simulation.problem.begin_step(simulation.state, 1.0)
    result = simulation.solver.step(simulation.problem, simulation.state, lambda row, x: rows.append(dict(row)))
    assert result.converged, result.reason
    assert {row["linear_iterations"] for row in rows} == {7}
