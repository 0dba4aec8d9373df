classdef dynamicprops < handle
%DYNAMICPROPS  For GNU Octave, which has no such class: what +crtk needs of MATLAB's.
%   Octave does not use subsref within the methods of a class. There, a class must declare the
%   properties that it calls itself: properties, measured_js; end.

    properties (Hidden)
        dynamic_values = struct();
    end

    methods

        function addprop(self, name)
            self.dynamic_values.(name) = [];
        end

        function result = isprop(self, name)
            result = isfield(self.dynamic_values, name) || any(strcmp(name, properties(self)));
        end

        function varargout = subsref(self, path)
            if ~strcmp(path(1).type, '.') || ~isfield(self.dynamic_values, path(1).subs)
                [varargout{1:nargout}] = builtin('subsref', self, path);
                return
            end
            value = self.dynamic_values.(path(1).subs);
            rest = path(2:end);
            if isempty(rest)
                varargout{1} = value;
            elseif isscalar(rest)
                [varargout{1:nargout}] = value(rest.subs{:});
            else
                if isa(value, 'function_handle')
                    value = value(rest(1).subs{:});
                    rest = rest(2:end);
                end
                [varargout{1:nargout}] = subsref(value, rest);
            end
        end

        function self = subsasgn(self, path, value)
            if isscalar(path) && strcmp(path.type, '.') && isfield(self.dynamic_values, path.subs)
                self.dynamic_values.(path.subs) = value;
            else
                self = builtin('subsasgn', self, path, value);
            end
        end

    end

end
