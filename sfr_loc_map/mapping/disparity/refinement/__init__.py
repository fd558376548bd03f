"""Refinement: one disparity field is fitted to both images (`variational_refinement.refine_disparity`).

Modules in the order of the calls:

    cell_field                    the field on cells of 2 x 2 pixels
    variational_refinement        iterations: both terms are linearised, then solved coarse to fine
      data_term                   data term: slopes and normal equations of photometric residuals
      residual_noise              data term: the noise of the residuals
      smoothness                  smoothness term: second differences, their scale and weights
      conjugate_gradients         the linear solver of both terms
      disparity_sigma             standard deviation of the refined disparity
"""
