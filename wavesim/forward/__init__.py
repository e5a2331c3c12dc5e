"""From an object's transmission to the amplitudes on pixels, with the adjoint and derivatives.

An engine takes the light behind the object to a field behind the lens. Free space takes that field to each
plane (:mod:`wavesim.forward.exit_field`), and a pixel measures the mean intensity on its square
(:mod:`wavesim.forward.pixel_means`). :class:`wavesim.forward.channel_model.ChannelModel` joins them, with the
adjoint step of the reconstruction. :class:`wavesim.forward.linear_model.LinearModel` has the derivatives with
respect to the object, the field and the light.
"""
