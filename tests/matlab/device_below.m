classdef device_below < dynamicprops
%DEVICE_BELOW  As the documentation makes a simple device, with whatever arguments crtk.utils may have.

    properties
        measured_cp  % declared, so that the methods of this class can call it in GNU Octave too
        crtk_utils
    end

    methods

        function self = device_below(varargin)
            self.crtk_utils = crtk.utils(self, varargin{:});
            self.crtk_utils.add_measured_cp();
            if numel(varargin) == 3
                self.crtk_utils.add_operating_state();
            end
            check(isequal(size(self.measured_cp()), [4 4]), 'called from within the class');
        end

    end

end
