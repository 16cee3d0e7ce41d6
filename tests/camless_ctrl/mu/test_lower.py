

def test_a_block_without_effect_does_not_disturb_the_search():
    # The eigenvalue of a nilpotent part has no slope; mu is that of the block that acts.
    M = np.array([[0.0, 2.0, 1.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    structure = BlockStructure([RealBlock("idle"), RealBlock("acting"), ComplexBlock("rest")])
    found = mu_lower(M, structure)
    assert found.value == pytest.approx(0.5, rel=1e-6)
